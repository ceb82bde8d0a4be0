/* HNF device core: the state machine of docs/serial-protocol.md, its queue, limits and ramps. Knows no hardware.
 * C99, no allocation, no floating point. SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Main loop: receive(), poll() at least every millisecond, temperature(), fault(), unplugged().
 * Sample clock (an interrupt of the same core): tick(). They share the queue without a lock: each index of it has one
 * writer, and whatever else a tick reads is written while no tick uses it. */
#ifndef HNF_DEVICE_H
#define HNF_DEVICE_H

#include "hnf_protocol.h"

#if UINTPTR_MAX < 0xFFFFFFFFu
#error "The queue is shared without a lock, which needs a processor that writes 32 bits at once: no AVR."
#endif

#ifdef __cplusplus
extern "C" {
#endif

#ifndef HNF_CHANNELS
#define HNF_CHANNELS 16 /* most */
#endif
#ifndef HNF_QUEUE_SAMPLES
#define HNF_QUEUE_SAMPLES 11520u /* int16s of memory: 15 ms of 16 channels at 48 kHz; at most 32767 */
#endif

#define HNF_QUEUE_MS 15     /* most that is owed */
#define HNF_RAMP_MS 4       /* from any sample to silence */
#define HNF_CREDIT_US 1000  /* between CREDITs: 2000 at most */
#define HNF_STATUS_US 100000
#define HNF_IDLE_US 20000   /* of no bytes, and a frame that was begun is given up */
#define HNF_AGAIN_US 100000 /* between two ERRORs of one kind */

typedef struct {
    const char *name;
    uint8_t channels, bits;          /* channels: at most HNF_CHANNELS */
    uint32_t lowest_hz, highest_hz;  
    uint16_t peak;                   /* largest count that the amplifier and transducer may ever get, 1–32767 */
    int16_t hot;                     /* 0.1 °C at which it falls silent; INT16_MAX: never */
    void (*send)(void *context, const uint8_t *bytes, size_t count);
    /* Let tick() come rate_hz times a second. 0: impossible after all. */
    int (*clock)(void *context, uint32_t rate_hz, uint8_t channels);
    void *context;
} hnf_config;

/* One core, so the compiler alone must keep the order of stores. */
#define HNF_BARRIER() __asm__ volatile("" ::: "memory")

enum hnf_command { HNF_OFF, HNF_RUN, HNF_DRAIN, HNF_DROP };   /* what the main loop wants of the tick */
enum hnf_phase { HNF_QUIET, HNF_FADING, HNF_SOUNDING };        /* what the tick does */

typedef struct {
    hnf_config config;
    hnf_decoder decoder;
    /* The main loop's. */
    uint8_t mode;  /* IDLE, READY, PLAYING (a stream lasts), FAULT */
    uint8_t after; /* mode that follows the stream */
    uint8_t known; /* session is of a stream since the last HELLO */
    uint8_t sequence, status_due, told_state;
    uint16_t session, queue, writing;
    int16_t last[HNF_CHANNELS]; /* put into the queue */
    uint32_t position;          /* of the frame that comes next */
    uint32_t crc_before, lost, now, heard, credit_at, status_at, error_at[HNF_E_HARDWARE + 1];
    uint16_t errors_told;
    int16_t temperature;
    /* Written by the main loop, read by the tick. */
    volatile uint8_t command;
    volatile uint32_t written;
    volatile uint16_t written_slot;
    uint8_t channels;
    uint16_t slots, fill_first, ramp, peak, slew, step;
    int16_t fifo[HNF_QUEUE_SAMPLES];
    /* Written by the tick, read by the main loop. */
    volatile uint8_t phase;
    volatile uint32_t read, played, underruns, limited;
    /* The tick's. */
    uint16_t reading, gain, waited;
    int16_t out[HNF_CHANNELS], fading[HNF_CHANNELS];
} hnf_device;

void hnf_device_init(hnf_device *device, const hnf_config *config);

/* Bytes from the host. now_us: of a clock that wraps at 2^32. */
void hnf_device_receive(hnf_device *device, const uint8_t *bytes, size_t count, uint32_t now_us);

/* CREDIT, STATUS and what else is due. */
void hnf_device_poll(hnf_device *device, uint32_t now_us);

/* The next frame → out (channels of the stream; silence where there is none). */
void hnf_device_tick(hnf_device *device, int16_t *out);

/* Of the coil or the amplifier, in 0.1 °C. */
void hnf_device_temperature(hnf_device *device, int16_t tenths);

/* The hardware cannot go on: silence by the ramp, ERROR, FAULT. code: HNF_E_HOT or HNF_E_HARDWARE. */
void hnf_device_fault(hnf_device *device, uint8_t code, const char *text);

/* The cable is out, or the port was closed: silence by the ramp, then IDLE. */
void hnf_device_unplugged(hnf_device *device);

uint8_t hnf_device_state(const hnf_device *device);

/* Frames that wait to be played. */
uint32_t hnf_device_queued(const hnf_device *device);

#ifdef __cplusplus
}
#endif

#endif
