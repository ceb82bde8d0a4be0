/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "hnf_protocol.h"

#include <string.h>

static uint16_t get16(const uint8_t *at) { return (uint16_t)(at[0] | (uint16_t)at[1] << 8); }

static uint32_t get32(const uint8_t *at) { return get16(at) | (uint32_t)get16(at + 2) << 16; }

static uint8_t *put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value & 0xFF);
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static uint8_t *put32(uint8_t *at, uint32_t value)
{
    return put16(put16(at, (uint16_t)(value & 0xFFFF)), (uint16_t)(value >> 16));
}

/* The table of one nibble: 32 bytes of flash, two steps a byte. */
static const uint16_t CRC_OF_NIBBLE[16] = {
    0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
    0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF,
};

uint16_t hnf_crc16(const uint8_t *bytes, size_t count)
{
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < count; i++) {
        crc = (uint16_t)(crc << 4 ^ CRC_OF_NIBBLE[crc >> 12 ^ bytes[i] >> 4]);
        crc = (uint16_t)(crc << 4 ^ CRC_OF_NIBBLE[crc >> 12 ^ (bytes[i] & 15)]);
    }
    return crc;
}

int16_t hnf_sample(const uint8_t *bytes)
{
    int32_t value = get16(bytes);
    return (int16_t)(value < 32768 ? value : value - 65536);
}

int hnf_get_hello(hnf_hello *to, const uint8_t *payload, uint16_t length)
{
    if (length != 2) return 0;
    to->lowest = payload[0];
    to->highest = payload[1];
    return 1;
}

int hnf_get_start(hnf_start *to, const uint8_t *payload, uint16_t length)
{
    if (length != 14) return 0;
    to->rate_hz = get32(payload);
    to->channels = payload[4];
    to->flags = payload[5];
    to->peak = get16(payload + 6);
    to->slew = get16(payload + 8);
    to->queue = get16(payload + 10);
    to->session = get16(payload + 12);
    return 1;
}

int hnf_get_samples(hnf_samples *to, const uint8_t *payload, uint16_t length)
{
    if (length < HNF_SAMPLES_HEAD || length % 2) return 0;
    to->session = get16(payload);
    to->position = get32(payload + 2);
    to->data = payload + HNF_SAMPLES_HEAD;
    to->samples = (uint16_t)((length - HNF_SAMPLES_HEAD) / 2);
    return 1;
}

int hnf_get_stop(uint8_t *drain, const uint8_t *payload, uint16_t length)
{
    if (length != 1) return 0;
    *drain = payload[0] == 1; /* what says neither is taken for now */
    return 1;
}

int hnf_get_ping(uint16_t *token, const uint8_t *payload, uint16_t length)
{
    if (length != 2) return 0;
    *token = get16(payload);
    return 1;
}

/* The text without its end; returns the place after it. */
static uint8_t *put_text(uint8_t *at, const char *text, size_t largest)
{
    size_t count = strlen(text);
    if (count > largest) {
        count = largest;
        while (count > 0 && ((uint8_t)text[count] & 0xC0) == 0x80) count--;
    }
    memcpy(at, text, count);
    return at + count;
}

uint16_t hnf_put_caps(uint8_t *payload, const hnf_caps *from)
{
    uint8_t *at = payload;
    *at++ = from->version;
    *at++ = from->channels;
    *at++ = from->bits;
    at = put32(put32(at, from->lowest_hz), from->highest_hz);
    at = put16(put16(put16(at, from->queue), from->peak), from->payload);
    return (uint16_t)(put_text(at, from->name, HNF_LARGEST_NAME) - payload);
}

uint16_t hnf_put_credit(uint8_t *payload, const hnf_credit *from)
{
    uint8_t *at = put32(put16(payload, from->session), from->played);
    at = put16(put16(at, from->queue), from->free);
    *at++ = from->state;
    return (uint16_t)(at - payload);
}

uint16_t hnf_put_status(uint8_t *payload, const hnf_status *from)
{
    uint8_t *at = put32(put32(payload, from->underruns), from->crc_errors);
    at = put32(put32(at, from->lost), from->limited);
    at = put16(at, (uint16_t)from->temperature);
    *at++ = from->state;
    return (uint16_t)(at - payload);
}

uint16_t hnf_put_pong(uint8_t *payload, uint16_t token) { return (uint16_t)(put16(payload, token) - payload); }

uint16_t hnf_put_error(uint8_t *payload, uint8_t code, const char *text)
{
    payload[0] = code;
    return (uint16_t)(put_text(payload + 1, text, HNF_LARGEST_TEXT) - payload);
}

size_t hnf_frame(uint8_t *out, uint8_t type, uint8_t sequence, const uint8_t *payload, uint16_t length)
{
    out[0] = 0xA5;
    out[1] = 0x5A;
    out[2] = type;
    out[3] = sequence;
    put16(out + 4, length);
    if (length > 0) memcpy(out + 6, payload, length);
    put16(out + 6 + length, hnf_crc16(out + 2, 4u + length));
    return (size_t)length + HNF_OVERHEAD;
}

/* Whether the host sends such a frame at all: a wrong length is noticed before its payload is waited for. */
static int plausible(uint8_t type, uint16_t length)
{
    switch (type) {
    case HNF_HELLO: return length == 2;
    case HNF_START: return length == 14;
    case HNF_SAMPLES: return length >= HNF_SAMPLES_HEAD && length <= HNF_LARGEST_PAYLOAD;
    case HNF_STOP: return length == 1;
    case HNF_PING: return length == 2;
    case HNF_BYE: return length == 0;
    default: return 0;
    }
}

/* 1: a frame begins at held[at] and is whole. 0: more bytes will tell. −1: none begins here. */
static int look(hnf_decoder *decoder, size_t at)
{
    const uint8_t *held = decoder->held + at;
    size_t count = decoder->count - at;
    if (held[0] != 0xA5 || (count > 1 && held[1] != 0x5A)) return -1;
    if (count < 6) return 0;
    uint16_t length = get16(held + 4);
    if (!plausible(held[2], length)) return -1;
    if (count < (size_t)length + HNF_OVERHEAD) return 0;
    if (hnf_crc16(held + 2, 4u + length) == get16(held + 6 + length)) return 1;
    decoder->crc_errors++;
    return -1;
}

static void deliver(hnf_decoder *decoder, const uint8_t *held, hnf_handler *handle, void *context)
{
    uint8_t type = held[2], sequence = held[3];
    /* A HELLO begins a conversation: what was sent before it is not missed. */
    if (decoder->started && type != HNF_HELLO) decoder->gaps += (uint8_t)(sequence - decoder->expected);
    decoder->started = 1;
    decoder->expected = (uint8_t)(sequence + 1);
    handle(context, type, held + 6, get16(held + 4));
}

/* Everything in held that can be told now; what is left begins at held[0]. */
static void scan(hnf_decoder *decoder, hnf_handler *handle, void *context)
{
    size_t at = 0;
    while (at < decoder->count) {
        int found = look(decoder, at);
        if (found == 0) break;
        if (found > 0) {
            size_t length = (size_t)get16(decoder->held + at + 4) + HNF_OVERHEAD;
            deliver(decoder, decoder->held + at, handle, context);
            at += length;
        } else {
            decoder->skipped++;
            at++;
        }
    }
    decoder->count -= at;
    memmove(decoder->held, decoder->held + at, decoder->count);
}

void hnf_decoder_init(hnf_decoder *decoder) { memset(decoder, 0, sizeof *decoder); }

void hnf_decoder_feed(hnf_decoder *decoder, const uint8_t *bytes, size_t count, hnf_handler *handle, void *context)
{
    while (count > 0) {
        /* A full held always holds something that can be told, so there is room after every scan. */
        size_t room = sizeof decoder->held - decoder->count;
        size_t take = count < room ? count : room;
        memcpy(decoder->held + decoder->count, bytes, take);
        decoder->count += take;
        bytes += take;
        count -= take;
        scan(decoder, handle, context);
    }
}

void hnf_decoder_idle(hnf_decoder *decoder, hnf_handler *handle, void *context)
{
    while (decoder->count > 0) {
        decoder->skipped++;
        decoder->count--;
        memmove(decoder->held, decoder->held + 1, decoder->count);
        scan(decoder, handle, context);
    }
}
