/* HNF device as an Arduino sketch, for an ESP32 and a Teensy: serial in, two channels of PWM out. Never run on hardware.
 * Put ../hnf_protocol.{h,c}, ../hnf_device.{h,c} and ../hnf_tick.c beside it. SPDX-License-Identifier: GPL-3.0-or-later */
#include <Arduino.h>

#include "hnf_device.h"

static const uint32_t BAUD = 921600; /* of a USB bridge: hnf stream FILE.wav --to serial:PORT@921600; no matter else */
static const uint8_t CHANNELS = 2, BITS = 10;
static const uint16_t REST = 1u << (BITS - 1);
static const size_t LINE_BYTES = 4096; /* twice the longest message */

static hnf_device device;

static uint16_t level(int16_t count) { return (uint16_t)(((int32_t)count + 32768) >> (16 - BITS)); }

#if defined(ESP32) /* arduino-esp32 3.x */
static const uint8_t LEFT_PIN = 25, RIGHT_PIN = 26, AMPLIFIER_PIN = 27;
static const uint32_t CARRIER_HZ = 78125;      /* 80 MHz / 1024 */
static const uint32_t CLOCK_HZ = 40000000;
static hw_timer_t *sample_clock;

static void write_levels(uint16_t left, uint16_t right)
{
    ledcWrite(LEFT_PIN, left);
    ledcWrite(RIGHT_PIN, right);
}

static void set_up_output(void)
{
    ledcAttach(LEFT_PIN, CARRIER_HZ, BITS);
    ledcAttach(RIGHT_PIN, CARRIER_HZ, BITS);
    write_levels(REST, REST);
}

static void sample_tick(void);

/* An interrupt of the core that asks for it, so setup() and loop() must run on one. */
static void set_up_clock(void)
{
    sample_clock = timerBegin(CLOCK_HZ);
    timerAttachInterrupt(sample_clock, sample_tick);
}

static int set_clock(void *, uint32_t rate_hz, uint8_t)
{
    timerAlarm(sample_clock, (CLOCK_HZ + rate_hz / 2) / rate_hz, true, 0);
    return 1;
}

static void set_up_line(void)
{
    Serial.setRxBufferSize(LINE_BYTES);
    Serial.setTxBufferSize(512);
    Serial.begin(BAUD);
}

static bool is_connected(void) { return true; } /* a bridge does not tell */

#elif defined(TEENSYDUINO)
static const uint8_t LEFT_PIN = 2, RIGHT_PIN = 3, AMPLIFIER_PIN = 4;
static const float CARRIER_HZ = 100000.0f;
static IntervalTimer sample_clock;

static void write_levels(uint16_t left, uint16_t right)
{
    analogWrite(LEFT_PIN, left);
    analogWrite(RIGHT_PIN, right);
}

static void set_up_output(void)
{
    analogWriteResolution(BITS);
    analogWriteFrequency(LEFT_PIN, CARRIER_HZ);
    analogWriteFrequency(RIGHT_PIN, CARRIER_HZ);
    write_levels(REST, REST);
}

static void sample_tick(void);

static void set_up_clock(void) {}

static int set_clock(void *, uint32_t rate_hz, uint8_t)
{
    sample_clock.end();
    return sample_clock.begin(sample_tick, 1e6f / (float)rate_hz);
}

static void set_up_line(void) { Serial.begin(BAUD); }

static bool is_connected(void) { return Serial; }

#else
#error "Write write_levels, set_up_output, set_up_clock, set_clock, set_up_line and is_connected of this board."
#endif

static void sample_tick(void)
{
    int16_t frame[HNF_CHANNELS] = { 0 };
    hnf_device_tick(&device, frame);
    write_levels(level(frame[0]), level(device.channels > 1 ? frame[1] : (int16_t)0));
}

/* What does not fit is dropped: the line must not hold up the main loop. */
static void send(void *, const uint8_t *bytes, size_t count)
{
    if ((size_t)Serial.availableForWrite() >= count) Serial.write(bytes, count);
}

void setup(void)
{
    const hnf_config config = {
        "HNF sketch", CHANNELS, BITS, 1000, 16000, 32767, INT16_MAX, send, set_clock, NULL
    };
    pinMode(AMPLIFIER_PIN, OUTPUT);
    digitalWrite(AMPLIFIER_PIN, LOW); /* a resistor to ground keeps the amplifier off in a reset */
    hnf_device_init(&device, &config);
    set_up_output();
    set_up_clock();
    set_up_line();
}

void loop(void)
{
    static bool was_connected = false;
    uint8_t bytes[256];
    size_t count = 0;
    bool connected = is_connected();
    if (was_connected && !connected) hnf_device_unplugged(&device);
    was_connected = connected;
    while (count < sizeof bytes && Serial.available() > 0) bytes[count++] = (uint8_t)Serial.read();
    if (count > 0) hnf_device_receive(&device, bytes, count, micros());
    hnf_device_poll(&device, micros());
    uint8_t state = hnf_device_state(&device);
    digitalWrite(AMPLIFIER_PIN, state == HNF_WAITING || state == HNF_PLAYING || state == HNF_STOPPING ? HIGH : LOW);
}
