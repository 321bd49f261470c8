/*
 * Receives poses over UDP, and prints the numbers of valid, usable and lost frames.
 *
 *     cc -std=c99 -O2 -o udp_receiver udp_receiver.c
 *     ./udp_receiver [PORT [FRAMES]]
 *
 * Port 0 selects any free port. With -DTRIFACET_NOT_REAL=0, poses of the digital twin count as usable.
 * Ends after FRAMES frames; without the argument, never.
 */
#define _POSIX_C_SOURCE 200809L

#include "trifacet.h"

#include <arpa/inet.h>
#include <inttypes.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define MAX_AGE_NS INT64_C(20000000)

static int open_port(uint16_t port)
{
    int fd = socket(AF_INET, SOCK_DGRAM, 0);
    int room = 1 << 20; /* the Linux default holds 256 frames, which arrive in 26 ms at 10 kHz */
    struct timeval silence = {.tv_sec = 1};
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(port)};
    address.sin_addr.s_addr = htonl(INADDR_ANY);
    if (fd < 0 || setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &room, sizeof room) != 0
        || setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &silence, sizeof silence) != 0
        || bind(fd, (struct sockaddr *)&address, sizeof address) != 0) {
        perror("udp_receiver: cannot open the port");
        exit(1);
    }
    socklen_t size = sizeof address;
    getsockname(fd, (struct sockaddr *)&address, &size);
    printf("listening on UDP port %u\n", (unsigned)ntohs(address.sin_port));
    fflush(stdout);
    return fd;
}

static int64_t utc_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

int main(int argc, char **argv)
{
    uint16_t port = (uint16_t)(argc > 1 ? strtoul(argv[1], NULL, 10) : 7362);
    uint64_t left = argc > 2 ? strtoull(argv[2], NULL, 10) : UINT64_MAX;
    int fd = open_port(port);
    struct trifacet_losses losses = {0};
    uint64_t frames = 0, valid = 0, usable = 0, refused = 0;
    int64_t interval_ns = 0, last_ns = 0; /* with long means, frames are rare */
    int silence_s = 0;

    while (frames < left) {
        uint8_t bytes[TRIFACET_FRAME_SIZE + 1]; /* a longer datagram must not look like a frame */
        ssize_t length = recv(fd, bytes, sizeof bytes, 0);
        struct trifacet_frame frame;
        if (length < 0) {
            if (++silence_s * INT64_C(1000000000) > 3 * interval_ns)
                fprintf(stderr, "udp_receiver: no frame for %d s: is the daemon running?\n", silence_s);
            continue;
        }
        if (trifacet_decode(&frame, bytes, (size_t)length) != TRIFACET_OK) {
            refused++;
            continue;
        }
        if (!trifacet_in_order(&losses, &frame))
            continue;
        frames++;
        interval_ns = last_ns ? frame.time_ns - last_ns : 0;
        last_ns = frame.time_ns;
        silence_s = 0;
        valid += (frame.status & TRIFACET_POSE_VALID) != 0;
        usable += (uint64_t)trifacet_usable(&frame, trifacet_age_ns(&frame, utc_ns()), MAX_AGE_NS);
        if (frames % 1000 == 0 || frames == left)
            printf("frames=%" PRIu64 " valid=%" PRIu64 " usable=%" PRIu64 " missed=%" PRIu64 " late=%" PRIu64
                   " refused=%" PRIu64 " tx=%.3f um ty=%.3f um tz=%.3f um\n",
                   frames, valid, usable, losses.missed, losses.late, refused, frame.position[0] * 1e6,
                   frame.position[1] * 1e6, frame.position[2] * 1e6);
    }
    close(fd);
    return 0;
}
