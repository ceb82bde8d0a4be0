/* HNF serial protocol, version 1: frames, checksum, messages. docs/serial-protocol.md says what they mean.
 * C99, no allocation, no floating point. SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef HNF_PROTOCOL_H
#define HNF_PROTOCOL_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define HNF_VERSION 1
#define HNF_OVERHEAD 8           /* bytes of a frame that are not payload */
#define HNF_LARGEST_PAYLOAD 2048 /* of a frame from the host */
#define HNF_LARGEST_NAME 64
#define HNF_LARGEST_TEXT 120
#define HNF_LARGEST_ANSWER (HNF_OVERHEAD + 1 + HNF_LARGEST_TEXT) /* longest frame of the device */
#define HNF_SAMPLES_HEAD 6       /* bytes of a SAMPLES payload before its frames */
#define HNF_NO_TEMPERATURE INT16_MIN

enum hnf_type {
    HNF_HELLO = 0x01, HNF_START = 0x02, HNF_SAMPLES = 0x03, HNF_STOP = 0x04, HNF_PING = 0x05, HNF_BYE = 0x06,
    HNF_CAPS = 0x81, HNF_CREDIT = 0x82, HNF_STATUS = 0x83, HNF_PONG = 0x84, HNF_ERROR = 0x85
};

enum hnf_state { HNF_IDLE = 0, HNF_READY, HNF_WAITING, HNF_PLAYING, HNF_STOPPING, HNF_FAULT };

enum hnf_code {
    HNF_E_VERSION = 1, HNF_E_BUSY, HNF_E_RATE, HNF_E_CHANNELS, HNF_E_LIMITS, HNF_E_STATE, HNF_E_SESSION,
    HNF_E_OVERRUN, HNF_E_MALFORMED, HNF_E_HOT, HNF_E_HARDWARE
};

typedef struct { uint8_t lowest, highest; } hnf_hello;
typedef struct { uint32_t rate_hz; uint8_t channels, flags; uint16_t peak, slew, queue, session; } hnf_start;
typedef struct { uint16_t session; uint32_t position; const uint8_t *data; uint16_t samples; } hnf_samples;
typedef struct {
    uint8_t version, channels, bits;
    uint32_t lowest_hz, highest_hz;
    uint16_t queue, peak, payload;
    const char *name;
} hnf_caps;
typedef struct { uint16_t session; uint32_t played; uint16_t queue, free; uint8_t state; } hnf_credit;
typedef struct { uint32_t underruns, crc_errors, lost, limited; int16_t temperature; uint8_t state; } hnf_status;

/* CRC-16/CCITT-FALSE. */
uint16_t hnf_crc16(const uint8_t *bytes, size_t count);

/* Payloads from the host → what they say. 0: means nothing (the frame is malformed). */
int hnf_get_hello(hnf_hello *to, const uint8_t *payload, uint16_t length);
int hnf_get_start(hnf_start *to, const uint8_t *payload, uint16_t length);
int hnf_get_samples(hnf_samples *to, const uint8_t *payload, uint16_t length); /* data points into payload */
int hnf_get_stop(uint8_t *drain, const uint8_t *payload, uint16_t length);
int hnf_get_ping(uint16_t *token, const uint8_t *payload, uint16_t length);

/* Little-endian int16 at bytes. */
int16_t hnf_sample(const uint8_t *bytes);

/* What the device says → payload (at least HNF_LARGEST_ANSWER bytes); returns its length. Texts are cut, between
 * characters of UTF-8, where they are too long. */
uint16_t hnf_put_caps(uint8_t *payload, const hnf_caps *from);
uint16_t hnf_put_credit(uint8_t *payload, const hnf_credit *from);
uint16_t hnf_put_status(uint8_t *payload, const hnf_status *from);
uint16_t hnf_put_pong(uint8_t *payload, uint16_t token);
uint16_t hnf_put_error(uint8_t *payload, uint8_t code, const char *text);

/* The frame around a payload of `length` bytes → out (length + HNF_OVERHEAD bytes); returns its length. */
size_t hnf_frame(uint8_t *out, uint8_t type, uint8_t sequence, const uint8_t *payload, uint16_t length);

/* Frames out of bytes in pieces of any size. What cannot be a frame costs its two bytes of sync only: everything after
 * them is looked at again. */
typedef struct {
    uint8_t held[HNF_LARGEST_PAYLOAD + HNF_OVERHEAD];
    size_t count;
    uint8_t expected, started;
    uint32_t crc_errors; /* frames whose CRC was wrong */
    uint32_t gaps;       /* frames missing by the sequence numbers, modulo 256 each time */
    uint32_t skipped;    /* bytes outside good frames */
} hnf_decoder;

typedef void hnf_handler(void *context, uint8_t type, const uint8_t *payload, uint16_t length);

void hnf_decoder_init(hnf_decoder *decoder);
void hnf_decoder_feed(hnf_decoder *decoder, const uint8_t *bytes, size_t count, hnf_handler *handle, void *context);

/* To be called when nothing has come for 20 ms: a frame that was begun and never ended is given up. */
void hnf_decoder_idle(hnf_decoder *decoder, hnf_handler *handle, void *context);

#ifdef __cplusplus
}
#endif

#endif
