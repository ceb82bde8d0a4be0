/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "hnf_device.h"

#include <string.h>

/* ---- what is said ---- */

uint8_t hnf_device_state(const hnf_device *device)
{
    if (device->mode != HNF_PLAYING) return device->mode;
    if (device->command != HNF_RUN) return HNF_STOPPING;
    return device->phase == HNF_SOUNDING ? HNF_PLAYING : HNF_WAITING;
}

uint32_t hnf_device_queued(const hnf_device *device) { return device->written - device->read; }

static void say(hnf_device *device, uint8_t type, const uint8_t *payload, uint16_t length)
{
    uint8_t frame[HNF_LARGEST_ANSWER];
    size_t count = hnf_frame(frame, type, device->sequence++, payload, length);
    device->config.send(device->config.context, frame, count);
}

static void say_error(hnf_device *device, uint8_t code, const char *text)
{
    uint8_t payload[HNF_LARGEST_ANSWER];
    uint16_t bit = (uint16_t)(1u << code);
    if ((device->errors_told & bit) && device->now - device->error_at[code] < HNF_AGAIN_US) return;
    device->errors_told |= bit;
    device->error_at[code] = device->now;
    say(device, HNF_ERROR, payload, hnf_put_error(payload, code, text));
}

static void say_credit(hnf_device *device)
{
    uint8_t payload[HNF_LARGEST_ANSWER];
    hnf_credit credit = { device->session, device->played, device->queue,
                          (uint16_t)(device->queue - hnf_device_queued(device)), hnf_device_state(device) };
    device->credit_at = device->now;
    say(device, HNF_CREDIT, payload, hnf_put_credit(payload, &credit));
}

static void say_status(hnf_device *device)
{
    uint8_t payload[HNF_LARGEST_ANSWER];
    hnf_status status = { device->underruns, device->decoder.crc_errors - device->crc_before, device->lost,
                          device->limited, device->temperature, hnf_device_state(device) };
    device->status_at = device->now;
    device->status_due = 0;
    device->told_state = status.state;
    say(device, HNF_STATUS, payload, hnf_put_status(payload, &status));
}

/* Frames of so many milliseconds, rounded down, but 1 at least. */
static uint32_t frames_of(uint32_t rate_hz, uint32_t ms)
{
    uint32_t frames = rate_hz / 1000 * ms + rate_hz % 1000 * ms / 1000;
    return frames > 0 ? frames : 1;
}

static uint32_t largest_queue(uint32_t rate_hz, uint8_t channels)
{
    uint32_t owed = frames_of(rate_hz, HNF_QUEUE_MS), memory = HNF_QUEUE_SAMPLES / channels;
    return owed < memory ? owed : memory;
}

static void say_caps(hnf_device *device)
{
    const hnf_config *config = &device->config;
    uint8_t payload[HNF_LARGEST_ANSWER];
    hnf_caps caps = { HNF_VERSION, config->channels, config->bits, config->lowest_hz, config->highest_hz,
                      (uint16_t)largest_queue(config->highest_hz, 1), config->peak, HNF_LARGEST_PAYLOAD,
                      config->name };
    say(device, HNF_CAPS, payload, hnf_put_caps(payload, &caps));
}

/* ---- what is done ---- */

/* Towards silence; mode `after` once it is reached. */
static void stop(hnf_device *device, uint8_t command, uint8_t after)
{
    if (device->mode != HNF_PLAYING) {
        device->mode = after;
        return;
    }
    /* FAULT outranks IDLE, and that READY. */
    if (device->command == HNF_RUN || after == HNF_FAULT || device->after == HNF_READY) device->after = after;
    if (device->command != HNF_DROP) device->command = command;
}

static int sounds(const hnf_device *device) { return device->phase != HNF_QUIET; }

static void on_hello(hnf_device *device, const hnf_hello *hello)
{
    if (sounds(device)) {
        say_error(device, HNF_E_BUSY, "Somebody is playing: stop that first.");
        return;
    }
    if (hello->lowest > HNF_VERSION || hello->highest < HNF_VERSION) {
        say_error(device, HNF_E_VERSION, "I speak version 1 only: use a host program of that version.");
        return;
    }
    device->command = HNF_OFF;
    device->mode = HNF_READY;
    device->known = 0;
    device->crc_before = device->decoder.crc_errors;
    device->lost = 0;
    device->underruns = 0;
    device->limited = 0;
    device->errors_told = 0;
    say_caps(device);
    device->status_due = 1;
}

/* Why START cannot be obeyed, or 0; `text` says it. */
static uint8_t refusal(const hnf_device *device, const hnf_start *start, const char **text)
{
    const hnf_config *config = &device->config;
    uint32_t ramp = frames_of(start->rate_hz, HNF_RAMP_MS);
    *text = "Stop first.";
    if (sounds(device)) return HNF_E_BUSY;
    *text = "Say HELLO first.";
    if (device->mode == HNF_IDLE || device->mode == HNF_FAULT) return HNF_E_STATE;
    *text = "Too hot: let it cool.";
    if (device->temperature != HNF_NO_TEMPERATURE && device->temperature >= config->hot) return HNF_E_HOT;
    *text = "No such rate here: see CAPS.";
    if (start->rate_hz < config->lowest_hz || start->rate_hz > config->highest_hz) return HNF_E_RATE;
    *text = "Not so many channels here: see CAPS.";
    if (start->channels < 1 || start->channels > config->channels) return HNF_E_CHANNELS;
    *text = "The peak is 0 or above that of CAPS.";
    if (start->peak < 1 || start->peak > config->peak) return HNF_E_LIMITS;
    *text = "With so small a slew silence would take more than 4 ms.";
    if ((start->peak + ramp - 1) / ramp > start->slew) return HNF_E_LIMITS;
    *text = "Flags are 0 in version 1.";
    return start->flags == 0 ? 0 : HNF_E_MALFORMED;
}

static void on_start(hnf_device *device, const hnf_start *start)
{
    const char *text;
    uint8_t code = refusal(device, start, &text);
    if (code != 0) {
        say_error(device, code, text);
        return;
    }
    device->command = HNF_OFF;
    HNF_BARRIER();
    uint32_t queue = largest_queue(start->rate_hz, start->channels);
    if (start->queue > 0 && start->queue < queue) queue = start->queue;
    device->session = start->session;
    device->queue = device->slots = (uint16_t)queue;
    device->fill_first = (uint16_t)((queue + 1) / 2);
    device->channels = start->channels;
    device->peak = start->peak;
    device->slew = start->slew;
    device->ramp = (uint16_t)frames_of(start->rate_hz, HNF_RAMP_MS);
    device->step = (uint16_t)((start->peak + device->ramp - 1) / device->ramp);
    device->gain = device->ramp; /* the host's own soft start; its first frames are played as they are */
    device->waited = 0;
    device->played = device->position = 0;
    /* A tick that comes now sets its indices to these two. */
    device->written_slot = device->writing = 0;
    device->written = 0;
    HNF_BARRIER();
    device->reading = 0;
    device->read = 0;
    device->known = 1;
    memset(device->last, 0, sizeof device->last);
    if (!device->config.clock(device->config.context, start->rate_hz, start->channels)) {
        say_error(device, HNF_E_RATE, "The sample clock cannot do this rate.");
        return;
    }
    device->mode = HNF_PLAYING;
    HNF_BARRIER();
    device->command = HNF_RUN;
    say_credit(device);
    device->status_due = 1;
}

static void put(hnf_device *device, const int16_t *frame)
{
    memcpy(device->fifo + (size_t)device->writing * device->channels, frame, device->channels * sizeof *frame);
    memcpy(device->last, frame, device->channels * sizeof *frame);
    device->writing = (uint16_t)(device->writing + 1 == device->slots ? 0 : device->writing + 1);
}

static void frame_of(const hnf_device *device, const hnf_samples *samples, uint32_t at, int16_t *frame)
{
    for (uint8_t c = 0; c < device->channels; c++) frame[c] = hnf_sample(samples->data + 2 * (at * device->channels + c));
}

/* A straight line over `gap` lost frames, from the last one before them to `next`. */
static void bridge(hnf_device *device, uint32_t gap, const int16_t *next)
{
    int16_t from[HNF_CHANNELS], frame[HNF_CHANNELS];
    memcpy(from, device->last, sizeof from);
    for (uint32_t k = 1; k <= gap; k++) {
        for (uint8_t c = 0; c < device->channels; c++)
            frame[c] = (int16_t)(from[c] + ((int32_t)next[c] - from[c]) * (int32_t)k / (int32_t)(gap + 1));
        put(device, frame);
    }
}

static void on_samples(hnf_device *device, const hnf_samples *samples)
{
    int16_t frame[HNF_CHANNELS] = { 0 };
    if (!device->known || samples->session != device->session) {
        say_error(device, HNF_E_SESSION, "These samples belong to no stream of mine: another program has the port.");
        return;
    }
    if (device->mode != HNF_PLAYING || device->command != HNF_RUN) return; /* sent before the host's STOP took effect */
    if (samples->samples % device->channels != 0) {
        say_error(device, HNF_E_MALFORMED, "Half a frame.");
        return;
    }
    uint32_t gap = samples->position - device->position, count = (uint32_t)samples->samples / device->channels;
    if (gap >= 0x80000000u) return; /* heard before */
    uint32_t free = device->queue - hnf_device_queued(device);
    if (gap > free || count > free - gap) {
        say_error(device, HNF_E_OVERRUN, "More than the credit allows: these samples are dropped.");
        return;
    }
    if (count > 0) frame_of(device, samples, 0, frame);
    bridge(device, gap, frame);
    for (uint32_t i = 0; i < count; i++) {
        frame_of(device, samples, i, frame);
        put(device, frame);
    }
    device->lost += gap;
    device->position += gap + count;
    HNF_BARRIER();
    device->written_slot = device->writing;
    device->written += gap + count;
}

static void handle(void *context, uint8_t type, const uint8_t *payload, uint16_t length)
{
    hnf_device *device = context;
    union { hnf_hello hello; hnf_start start; hnf_samples samples; uint8_t drain; uint16_t token; } got;
    switch (type) {
    case HNF_HELLO:
        if (hnf_get_hello(&got.hello, payload, length)) on_hello(device, &got.hello);
        return;
    case HNF_START:
        if (hnf_get_start(&got.start, payload, length)) on_start(device, &got.start);
        return;
    case HNF_SAMPLES:
        if (hnf_get_samples(&got.samples, payload, length)) on_samples(device, &got.samples);
        else say_error(device, HNF_E_MALFORMED, "Half a sample.");
        return;
    case HNF_STOP:
        if (!hnf_get_stop(&got.drain, payload, length)) return;
        if (device->mode == HNF_PLAYING) stop(device, got.drain ? HNF_DRAIN : HNF_DROP, HNF_READY);
        else if (device->mode == HNF_READY) say_credit(device);
        return;
    case HNF_PING:
        if (hnf_get_ping(&got.token, payload, length)) {
            uint8_t answer[HNF_LARGEST_ANSWER];
            say(device, HNF_PONG, answer, hnf_put_pong(answer, got.token));
            device->status_due = 1;
        }
        return;
    case HNF_BYE:
        hnf_device_unplugged(device);
        return;
    default: return;
    }
}

/* Held back behind a damaged length: too old to be played, and not too old to stop. */
static void handle_late(void *context, uint8_t type, const uint8_t *payload, uint16_t length)
{
    if (type != HNF_SAMPLES) handle(context, type, payload, length);
}

/* ---- the main loop ---- */

void hnf_device_init(hnf_device *device, const hnf_config *config)
{
    memset(device, 0, sizeof *device);
    device->config = *config;
    device->temperature = HNF_NO_TEMPERATURE;
    device->channels = config->channels;
    device->slots = 1;
    hnf_decoder_init(&device->decoder);
}

void hnf_device_receive(hnf_device *device, const uint8_t *bytes, size_t count, uint32_t now_us)
{
    device->now = now_us;
    if (device->decoder.count > 0 && now_us - device->heard >= HNF_IDLE_US)
        hnf_decoder_idle(&device->decoder, handle_late, device);
    if (count > 0) device->heard = now_us;
    hnf_decoder_feed(&device->decoder, bytes, count, handle, device);
}

void hnf_device_poll(hnf_device *device, uint32_t now_us)
{
    hnf_device_receive(device, NULL, 0, now_us);
    if (device->mode == HNF_PLAYING && device->command != HNF_RUN && !sounds(device)
        && hnf_device_queued(device) == 0) {
        device->command = HNF_OFF;
        device->mode = device->after;
        say_credit(device);
    }
    if (device->mode == HNF_PLAYING && now_us - device->credit_at >= HNF_CREDIT_US) say_credit(device);
    if (device->mode == HNF_PLAYING && now_us - device->status_at >= HNF_STATUS_US) device->status_due = 1;
    if (device->status_due || hnf_device_state(device) != device->told_state) say_status(device);
}

void hnf_device_temperature(hnf_device *device, int16_t tenths)
{
    device->temperature = tenths;
    if (tenths != HNF_NO_TEMPERATURE && tenths >= device->config.hot && device->mode == HNF_PLAYING)
        hnf_device_fault(device, HNF_E_HOT, "Too hot: let it cool.");
}

void hnf_device_fault(hnf_device *device, uint8_t code, const char *text)
{
    say_error(device, code, text);
    stop(device, HNF_DROP, HNF_FAULT);
}

void hnf_device_unplugged(hnf_device *device)
{
    /* A fault outlives its host: only HELLO ends it. */
    if (device->mode != HNF_FAULT) stop(device, HNF_DROP, HNF_IDLE);
}
