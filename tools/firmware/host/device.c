/* A device on this machine: speaks the protocol on a pty (or on a port) in real time, and writes what it plays.
 * SPDX-License-Identifier: GPL-3.0-or-later
 *
 * device OUT.raw [--port PATH] [--channels N] [--percent P] [--patient] [--once]
 *   OUT.raw     int16 of every frame since the first START, in the machine's byte order
 *   --port      a serial port instead of a new pty, whose name is printed
 *   --percent   of the rate that was asked for: a device that lies
 *   --patient   its sample clock waits for samples while it plays, so that a slow machine causes no underrun
 *   --once      ends when its host has said BYE or is gone */
#define _XOPEN_SOURCE 600
#include "../hnf_device.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static volatile sig_atomic_t ending;
static int line;

typedef struct { double hz, percent, began_s; uint64_t ticks; } sample_clock;

static void end(int number)
{
    (void)number;
    ending = 1;
}

static double now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static uint32_t now_us(void) { return (uint32_t)(uint64_t)(now_s() * 1e6); }

/* As USB does, it drops what nobody reads. */
static void send(void *context, const uint8_t *bytes, size_t count)
{
    (void)context;
    if (write(line, bytes, count) < 0 && errno != EAGAIN && errno != EIO) ending = 1;
}

static int set_clock(void *context, uint32_t rate_hz, uint8_t channels)
{
    sample_clock *clock = context;
    (void)channels;
    clock->hz = rate_hz * clock->percent / 100.0;
    clock->began_s = now_s();
    clock->ticks = 0;
    return 1;
}

static int open_line(const char *port)
{
    struct termios raw;
    int found = port ? open(port, O_RDWR | O_NOCTTY) : posix_openpt(O_RDWR | O_NOCTTY);
    if (found < 0 || (!port && (grantpt(found) != 0 || unlockpt(found) != 0)) || tcgetattr(found, &raw) != 0) return -1;
    raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
    raw.c_cflag = CS8 | CREAD | CLOCAL;
    if (tcsetattr(found, TCSANOW, &raw) != 0 || fcntl(found, F_SETFL, O_NONBLOCK) != 0) return -1;
    if (!port) {
        puts(ptsname(found));
        fflush(stdout);
    }
    return found;
}

/* Everything that has come. 0: nobody is at the other end. */
static int listen_to_host(hnf_device *device)
{
    uint8_t bytes[4096];
    struct pollfd what = { line, POLLIN, 0 };
    poll(&what, 1, 1);
    for (;;) {
        ssize_t count = read(line, bytes, sizeof bytes);
        if (count > 0) hnf_device_receive(device, bytes, (size_t)count, now_us());
        else if (count == 0 || (count < 0 && errno == EIO)) return 0;
        else return 1;
    }
}

static void play(hnf_device *device, sample_clock *clock, int patient, FILE *out)
{
    int16_t frame[HNF_CHANNELS];
    uint64_t due = clock->hz > 0.0 ? (uint64_t)((now_s() - clock->began_s) * clock->hz) : 0;
    while (clock->ticks < due) {
        if (patient && hnf_device_state(device) == HNF_PLAYING && hnf_device_queued(device) == 0) {
            clock->began_s += (double)(due - clock->ticks) / clock->hz;
            return;
        }
        hnf_device_tick(device, frame);
        fwrite(frame, sizeof *frame, device->channels, out);
        clock->ticks++;
    }
}

int main(int count, char **words)
{
    static hnf_device device;
    sample_clock clock = { 0.0, 100.0, 0.0, 0 };
    hnf_config config = { "host/device.c", 1, 16, 1000, 48000, 32767, INT16_MAX, send, set_clock, &clock };
    const char *port = NULL;
    int patient = 0, once = 0, there = 0;
    for (int i = 2; i < count; i++) {
        const char *value = i + 1 < count ? words[i + 1] : "";
        if (strcmp(words[i], "--patient") == 0) patient = 1;
        else if (strcmp(words[i], "--once") == 0) once = 1;
        else if (strcmp(words[i], "--port") == 0) port = value, i++;
        else if (strcmp(words[i], "--channels") == 0) config.channels = (uint8_t)atoi(value), i++;
        else if (strcmp(words[i], "--percent") == 0) clock.percent = atof(value), i++;
        else count = 0;
    }
    FILE *out = count > 1 ? fopen(words[1], "wb") : NULL;
    if (out == NULL || config.channels < 1 || config.channels > HNF_CHANNELS || (line = open_line(port)) < 0) {
        fprintf(stderr, "device OUT.raw [--port PATH] [--channels N] [--percent P] [--patient] [--once]\n");
        return 2;
    }
    signal(SIGTERM, end);
    signal(SIGINT, end);
    hnf_device_init(&device, &config);
    for (int met = 0; !ending; ) {
        int heard = listen_to_host(&device);
        if (there && !heard) hnf_device_unplugged(&device);
        there = heard;
        play(&device, &clock, patient, out);
        hnf_device_poll(&device, now_us());
        met |= hnf_device_state(&device) != HNF_IDLE;
        if (once && met && hnf_device_state(&device) == HNF_IDLE) break;
        if (!there) nanosleep(&(struct timespec){ 0, 1000000 }, NULL);
    }
    return fclose(out) == 0 ? 0 : 1;
}
