/* The protocol and the device core on a host, driven over stdin, for the tests. SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Request: op u8, argument u32, count u32, bytes. Reply: count u32, bytes. All in the machine's own byte order.
 *   c  CRC of bytes → u16                     z  new decoder
 *   d  bytes in pieces of argument → a line of text for each message; i  the decoder is idle
 *   n  the decoder's counters, as text        e  a line of text → the frame, sequence = argument
 *   R  new device; bytes: a hnf_config's numbers as text
 *   F  bytes at argument µs → what it sends   P  poll at argument µs → what it sends
 *   W  as if argument frames more had been played already
 *   T  argument ticks → int16 of each         H  temperature; U  cable out; X  hardware fault → what it sends */
#include "../hnf_device.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LARGEST (1u << 20)

static uint8_t in[LARGEST], out[4 * LARGEST];
static size_t out_count;
static hnf_decoder decoder;
static hnf_device device;
static char name[HNF_LARGEST_NAME + 1] = "host";

static void append(const void *bytes, size_t count)
{
    if (out_count + count > sizeof out) abort();
    if (count > 0) memcpy(out + out_count, bytes, count);
    out_count += count;
}

static void append_text(const char *text) { append(text, strlen(text)); }

static void tell(void *context, uint8_t type, const uint8_t *payload, uint16_t length)
{
    char line[160];
    union { hnf_hello hello; hnf_start start; hnf_samples samples; uint8_t drain; uint16_t token; } got;
    (void)context;
    strcpy(line, "malformed\n");
    if (type == HNF_HELLO && hnf_get_hello(&got.hello, payload, length))
        snprintf(line, sizeof line, "hello %u %u\n", got.hello.lowest, got.hello.highest);
    if (type == HNF_START && hnf_get_start(&got.start, payload, length))
        snprintf(line, sizeof line, "start %" PRIu32 " %u %u %u %u %u %u\n", got.start.rate_hz, got.start.channels,
                 got.start.flags, got.start.peak, got.start.slew, got.start.queue, got.start.session);
    if (type == HNF_STOP && hnf_get_stop(&got.drain, payload, length))
        snprintf(line, sizeof line, "stop %u\n", got.drain);
    if (type == HNF_PING && hnf_get_ping(&got.token, payload, length))
        snprintf(line, sizeof line, "ping %u\n", got.token);
    if (type == HNF_BYE) strcpy(line, "bye\n");
    if (type == HNF_SAMPLES && hnf_get_samples(&got.samples, payload, length)) {
        snprintf(line, sizeof line, "samples %u %" PRIu32, got.samples.session, got.samples.position);
        append_text(line);
        for (uint16_t i = 0; i < got.samples.samples; i++) {
            snprintf(line, sizeof line, " %d", hnf_sample(got.samples.data + 2 * i));
            append_text(line);
        }
        strcpy(line, "\n");
    }
    append_text(line);
}

/* Numbers and the rest of a line of text. */
static int numbers(const char *text, const char *word, long long *to, int count, const char **rest)
{
    size_t length = strlen(word);
    if (strncmp(text, word, length) != 0) return 0;
    text += length;
    for (int i = 0; i < count; i++) {
        char *end;
        to[i] = strtoll(text, &end, 10);
        if (end == text) return 0;
        text = end;
    }
    *rest = *text == ' ' ? text + 1 : text;
    return 1;
}

static void encode(const char *text, uint8_t sequence)
{
    uint8_t payload[HNF_LARGEST_ANSWER], frame[HNF_LARGEST_ANSWER];
    long long v[8];
    const char *rest;
    uint8_t type = 0;
    uint16_t length = 0;
    if (numbers(text, "caps", v, 8, &rest)) {
        hnf_caps caps = { (uint8_t)v[0], (uint8_t)v[1], (uint8_t)v[2], (uint32_t)v[3], (uint32_t)v[4],
                          (uint16_t)v[5], (uint16_t)v[6], (uint16_t)v[7], rest };
        length = hnf_put_caps(payload, &caps);
        type = HNF_CAPS;
    } else if (numbers(text, "credit", v, 5, &rest)) {
        hnf_credit credit = { (uint16_t)v[0], (uint32_t)v[1], (uint16_t)v[2], (uint16_t)v[3], (uint8_t)v[4] };
        length = hnf_put_credit(payload, &credit);
        type = HNF_CREDIT;
    } else if (numbers(text, "status", v, 6, &rest)) {
        hnf_status status = { (uint32_t)v[0], (uint32_t)v[1], (uint32_t)v[2], (uint32_t)v[3], (int16_t)v[4],
                              (uint8_t)v[5] };
        length = hnf_put_status(payload, &status);
        type = HNF_STATUS;
    } else if (numbers(text, "pong", v, 1, &rest)) {
        length = hnf_put_pong(payload, (uint16_t)v[0]);
        type = HNF_PONG;
    } else if (numbers(text, "error", v, 1, &rest)) {
        length = hnf_put_error(payload, (uint8_t)v[0], rest);
        type = HNF_ERROR;
    }
    append(frame, hnf_frame(frame, type, sequence, payload, length));
}

static void send(void *context, const uint8_t *bytes, size_t count)
{
    (void)context;
    append(bytes, count);
}

static int start_clock(void *context, uint32_t rate_hz, uint8_t channels)
{
    (void)context;
    (void)channels;
    return rate_hz != 11025; /* a rate that turns out to be impossible */
}

static void new_device(const char *text)
{
    long long v[6];
    const char *rest;
    if (!numbers(text, "", v, 6, &rest)) abort();
    hnf_config config = { name, (uint8_t)v[0], (uint8_t)v[1], (uint32_t)v[2], (uint32_t)v[3], (uint16_t)v[4],
                          (int16_t)v[5], send, start_clock, NULL };
    hnf_device_init(&device, &config);
}

static void decode(uint32_t count, uint32_t piece)
{
    for (uint32_t at = 0; at < count; at += piece) {
        /* A copy of the very size, so that a read beyond it is noticed. */
        uint32_t length = count - at < piece ? count - at : piece;
        uint8_t *bytes = malloc(length);
        if (bytes == NULL) abort();
        memcpy(bytes, in + at, length);
        hnf_decoder_feed(&decoder, bytes, length, tell, NULL);
        free(bytes);
    }
}

static void answer(uint8_t op, uint32_t argument, uint32_t count)
{
    char line[120];
    int16_t frame[HNF_CHANNELS];
    uint16_t crc;
    switch (op) {
    case 'c':
        crc = hnf_crc16(in, count);
        append(&crc, sizeof crc);
        break;
    case 'z': hnf_decoder_init(&decoder); break;
    case 'd': decode(count, argument); break;
    case 'i': hnf_decoder_idle(&decoder, tell, NULL); break;
    case 'n':
        snprintf(line, sizeof line, "%" PRIu32 " %" PRIu32 " %" PRIu32, decoder.crc_errors, decoder.gaps,
                 decoder.skipped);
        append_text(line);
        break;
    case 'e': encode((const char *)in, (uint8_t)argument); break;
    case 'R': new_device((const char *)in); break;
    case 'F': hnf_device_receive(&device, in, count, argument); break;
    case 'P': hnf_device_poll(&device, argument); break;
    case 'T':
        while (argument-- > 0) {
            hnf_device_tick(&device, frame);
            append(frame, device.channels * sizeof *frame);
        }
        break;
    case 'W':
        device.played += argument;
        device.position += argument;
        device.read += argument;
        device.written += argument;
        break;
    case 'H': hnf_device_temperature(&device, (int16_t)argument); break;
    case 'U': hnf_device_unplugged(&device); break;
    case 'X': hnf_device_fault(&device, HNF_E_HARDWARE, "The amplifier says no."); break;
    default: abort();
    }
}

int main(void)
{
    struct { uint32_t argument, count; } request;
    int op;
    hnf_decoder_init(&decoder);
    while ((op = getchar()) != EOF) {
        if (fread(&request, sizeof request, 1, stdin) != 1 || request.count >= LARGEST) return 1;
        if (fread(in, 1, request.count, stdin) != request.count) return 1;
        in[request.count] = 0;
        out_count = 0;
        answer((uint8_t)op, request.argument, request.count);
        uint32_t count = (uint32_t)out_count;
        fwrite(&count, sizeof count, 1, stdout);
        fwrite(out, 1, out_count, stdout);
        fflush(stdout);
    }
    return 0;
}
