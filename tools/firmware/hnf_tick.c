/* What a device plays, frame by frame: the side of the sample clock. SPDX-License-Identifier: GPL-3.0-or-later */
#include "hnf_device.h"

#include <string.h>

/* The count that may follow `before`: within peak, and within slew of it. */
static int16_t limited(hnf_device *device, int32_t wanted, int16_t before)
{
    int32_t peak = device->peak, slew = device->slew, value = wanted;
    if (value > peak) value = peak;
    if (value < -peak) value = -peak;
    if (value > before + slew) value = before + slew;
    if (value < before - slew) value = before - slew;
    if (value != wanted) device->limited++;
    return (int16_t)value;
}

static int may_begin(hnf_device *device, uint8_t command, uint32_t fill)
{
    if (fill == 0) return 0;
    return command == HNF_DRAIN || fill >= device->fill_first || ++device->waited >= device->ramp;
}

/* Nothing is left to play: what sounds fades, and what comes next rises from nothing. */
static void let_fade(hnf_device *device)
{
    memcpy(device->fading, device->out, sizeof device->fading);
    device->gain = 0;
    device->waited = 0;
    device->phase = HNF_FADING;
}

/* One step of what fades towards silence. */
static int16_t faded(const hnf_device *device, int16_t value)
{
    int32_t now = value, step = device->step;
    return (int16_t)(now > step ? now - step : now < -step ? now + step : 0);
}

/* The oldest frame of the queue joins what fades. */
static void play(hnf_device *device)
{
    const int16_t *frame = device->fifo + (size_t)device->reading * device->channels;
    if (device->gain < device->ramp) device->gain++;
    for (uint8_t c = 0; c < device->channels; c++) {
        int32_t wanted = frame[c];
        if (device->gain < device->ramp) wanted = wanted * device->gain / device->ramp;
        device->out[c] = limited(device, device->fading[c] + wanted, device->out[c]);
    }
    device->reading = (uint16_t)(device->reading + 1 == device->slots ? 0 : device->reading + 1);
    HNF_BARRIER();
    device->read++;
    device->played++;
}

void hnf_device_tick(hnf_device *device, int16_t *out)
{
    uint8_t command = device->command, silent = 1;
    uint32_t fill = device->written - device->read;
    HNF_BARRIER();
    if (command == HNF_DROP || command == HNF_OFF) {
        device->reading = device->written_slot;
        device->read = device->written;
        if (device->phase == HNF_SOUNDING) let_fade(device);
    } else if (device->phase == HNF_SOUNDING && fill == 0) {
        if (command == HNF_RUN) device->underruns++;
        let_fade(device);
    } else if (device->phase != HNF_SOUNDING && may_begin(device, command, fill)) {
        device->phase = HNF_SOUNDING;
    }
    for (uint8_t c = 0; c < device->channels; c++) {
        device->fading[c] = faded(device, device->fading[c]);
        silent &= device->fading[c] == 0;
    }
    if (device->phase == HNF_SOUNDING) play(device);
    else memcpy(device->out, device->fading, sizeof device->out);
    if (device->phase == HNF_FADING && silent) device->phase = HNF_QUIET;
    memcpy(out, device->out, device->channels * sizeof *out);
}
