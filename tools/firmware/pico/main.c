/* HNF device on a Raspberry Pi Pico (RP2040): USB serial in, two channels of PWM out. Never run on hardware yet.
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "../hnf_device.h"

#include "hardware/clocks.h"
#include "hardware/gpio.h"
#include "hardware/irq.h"
#include "hardware/pwm.h"
#include "hardware/watchdog.h"
#include "pico/stdio/driver.h"
#include "pico/stdio_usb.h"
#include "pico/stdlib.h"

enum {
    CHANNELS = 2,
    LEFT_PIN = 0,   /* channel A of slice 0 */
    RIGHT_PIN = 1,  /* channel B of slice 0 */
    AMPLIFIER_PIN = 2, /* high while a stream lasts; a resistor to ground keeps the amplifier off in a reset */
    OUTPUT_SLICE = 0,
    CLOCK_SLICE = 7, /* its pins stay free: it only counts */
    BITS = 10,       /* carrier = 125 MHz / 1024 = 122 kHz */
    REST = 1 << (BITS - 1)
};

static hnf_device device;

static uint16_t level(int16_t count) { return (uint16_t)(((int32_t)count + 32768) >> (16 - BITS)); }

static void sample_tick(void)
{
    int16_t frame[HNF_CHANNELS] = { 0 };
    pwm_clear_irq(CLOCK_SLICE);
    hnf_device_tick(&device, frame);
    pwm_set_both_levels(OUTPUT_SLICE, level(frame[0]), level(device.channels > 1 ? frame[1] : 0));
}

/* The rate is off by half a cycle of some ten thousand at most: 0.006 % at 16 kHz. */
static int set_clock(void *context, uint32_t rate_hz, uint8_t channels)
{
    uint32_t cycles = (clock_get_hz(clk_sys) + rate_hz / 2) / rate_hz, divider = cycles / 65536 + 1;
    (void)context;
    (void)channels;
    if (divider > 255) return 0;
    pwm_set_enabled(CLOCK_SLICE, false);
    pwm_set_clkdiv_int_frac(CLOCK_SLICE, (uint8_t)divider, 0);
    pwm_set_wrap(CLOCK_SLICE, (uint16_t)((cycles + divider / 2) / divider - 1));
    pwm_set_counter(CLOCK_SLICE, 0);
    pwm_set_enabled(CLOCK_SLICE, true);
    return 1;
}

static void send(void *context, const uint8_t *bytes, size_t count)
{
    (void)context;
    stdio_usb.out_chars((const char *)bytes, (int)count);
}

static void set_up_output(void)
{
    pwm_config config = pwm_get_default_config();
    gpio_init(AMPLIFIER_PIN);
    gpio_set_dir(AMPLIFIER_PIN, GPIO_OUT);
    gpio_put(AMPLIFIER_PIN, false);
    pwm_config_set_wrap(&config, (1 << BITS) - 1);
    pwm_init(OUTPUT_SLICE, &config, true);
    pwm_set_both_levels(OUTPUT_SLICE, REST, REST);
    gpio_set_function(LEFT_PIN, GPIO_FUNC_PWM);
    gpio_set_function(RIGHT_PIN, GPIO_FUNC_PWM);
    pwm_set_irq_enabled(CLOCK_SLICE, true);
    irq_set_exclusive_handler(PWM_IRQ_WRAP, sample_tick);
    irq_set_priority(PWM_IRQ_WRAP, PICO_HIGHEST_IRQ_PRIORITY);
    irq_set_enabled(PWM_IRQ_WRAP, true);
}

int main(void)
{
    const hnf_config config = { "HNF on a Pico", CHANNELS, BITS, 1000, 16000, 32767, INT16_MAX, send, set_clock, NULL };
    bool there = false;
    hnf_device_init(&device, &config);
    set_up_output();
    stdio_usb_init();
    watchdog_enable(100, true);
    for (;;) {
        char bytes[256];
        bool connected = stdio_usb_connected();
        if (there && !connected) hnf_device_unplugged(&device);
        there = connected;
        int count = stdio_usb.in_chars(bytes, sizeof bytes);
        if (count > 0) hnf_device_receive(&device, (const uint8_t *)bytes, (size_t)count, time_us_32());
        hnf_device_poll(&device, time_us_32());
        uint8_t state = hnf_device_state(&device);
        gpio_put(AMPLIFIER_PIN, state == HNF_WAITING || state == HNF_PLAYING || state == HNF_STOPPING);
        watchdog_update();
    }
}
