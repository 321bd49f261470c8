/* A board on a pseudo-terminal: the core of the firmware with a simulated sensor.
 *
 *     board LINK [KEY=VALUE ...]
 *
 * LINK becomes a symbolic link to the terminal. For each scan the program prints a line: its number; the true pose
 * (tx, ty, tz in metres, roll, pitch, yaw in radians); the true time of the scan (nanoseconds of the system clock);
 * how much later this program took it, because it had no processor (nanoseconds); the codes of the outputs x, y; 1 if
 * the lease has expired. The program ends when its standard input is closed.
 */
#define _XOPEN_SOURCE 600
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../core/serve.h"
#include "../sensor/sensor.h"

#define TICK_HZ 1000000u
#define OUTPUT_BITS 16
#define LOOK_NS 300000 /* longest time between two looks at the line */
#define FULL_SCALE_M 500e-6 /* position of the stage at the full-scale code */

/* A byte from the host on its way to the board. */
typedef struct {
    uint8_t byte;
    int64_t arrival_ns;
} travelling;

/* Everything that the program knows. */
typedef struct {
    options o;
    tf_identity identity;
    tf_board board;
    sensor sensor;
    int line;              /* master side of the terminal */
    int64_t power_up_ns;   /* by the monotonic clock */
    int64_t system_ns;     /* system clock minus monotonic clock */
    uint64_t stopped_tick; /* at the begin of the faults */
    uint8_t pending[65536]; /* bytes for the line, as in the buffers of an adapter */
    size_t pending_length;
    travelling received[4096]; /* from the host; the first `taken` have reached the board */
    size_t received_length, taken;
    int32_t outputs[2];
    uint8_t frame[TF_MAX_FRAME]; /* from the core, until it is complete */
    size_t frame_length;
    bool faulty;                /* faults act in the last scan */
    bool restarted;             /* the board has answered START in this turn */
    uint8_t late[TF_MAX_FRAME]; /* a scan that is sent after its successor */
    size_t late_length;
} host;

/* The only one: the functions of the port have no argument for it. */
static host the_host;

static void fail(const char *what)
{
    fprintf(stderr, "%s: %s\n", what, strerror(errno));
    exit(1);
}

static int64_t clock_ns(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* Nanoseconds per tick of the board's own clock. */
static double tick_ns(const host *h)
{
    return 1e9 / TICK_HZ * (1 + h->o.clock_ppm * 1e-6);
}

static uint64_t now(const host *h)
{
    return (uint64_t)((double)(clock_ns(CLOCK_MONOTONIC) - h->power_up_ns) / tick_ns(h));
}

/* A terminal in raw mode. It keeps this mode while nobody has its slave side open. */
static int open_line(const char *link)
{
    int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) != 0 || unlockpt(master) != 0) {
        fail("cannot open a pseudo-terminal");
    }
    const char *name = ptsname(master);
    int slave = open(name, O_RDWR | O_NOCTTY);
    struct termios mode;
    if (slave < 0 || tcgetattr(slave, &mode) != 0) {
        fail(name);
    }
    mode.c_iflag = mode.c_oflag = mode.c_lflag = 0;
    mode.c_cflag = (mode.c_cflag & ~(tcflag_t)(CSIZE | PARENB)) | CS8;
    if (tcsetattr(slave, TCSANOW, &mode) != 0 || fcntl(master, F_SETFL, O_NONBLOCK) != 0 || symlink(name, link) != 0) {
        fail(link);
    }
    close(slave);
    return master;
}

static tf_identity identity_of(const options *o)
{
    tf_identity id = {TICK_HZ, (uint8_t)o->bits, OUTPUT_BITS, (uint32_t)o->range_mv, 1000, 5000000, true,
                      SENSOR_CHANNELS, {{0, 0}}, "Reference board 1.1 #1", (uint8_t)o->minor, o->wide > 0,
                      (uint32_t)o->boot, 0, {{0, 0, 0, 0, 0}}};
    for (unsigned i = 0; i < SENSOR_CHANNELS; i++) {
        unsigned role = i < 9 ? (i % 3 + 1) * 0x10 + i / 3 : TF_ROLE_READBACK + i - 9;
        id.channel[i].role = (uint8_t)role;
        id.channel[i].skew_ns = (uint32_t)lrint(i * o->skew_us * 1000);
    }
    return id;
}

static void flush(host *h)
{
    ssize_t sent = write(h->line, h->pending, h->pending_length);
    if (sent > 0) {
        h->pending_length -= (size_t)sent;
        memmove(h->pending, h->pending + sent, h->pending_length);
    }
}

static void put(host *h, const uint8_t *bytes, size_t length)
{
    if (h->pending_length + length <= sizeof h->pending) { /* otherwise the line loses a whole frame */
        memcpy(h->pending + h->pending_length, bytes, length);
        h->pending_length += length;
    }
}

/* The tick that the scan carries. */
static uint64_t stated_tick(host *h, uint64_t tick, uint32_t sequence)
{
    if (!sensor_faulty(&h->o, sequence)) {
        h->stopped_tick = tick;
        return tick;
    }
    double since = (double)(tick - h->stopped_tick) * h->o.tick_factor;
    tick = h->stopped_tick + (uint64_t)since;
    if (sequence == h->o.at) {
        tick += (uint64_t)(int64_t)h->o.tick_step;
    }
    return h->o.tick_bits < 64 ? tick & (((uint64_t)1 << (unsigned)h->o.tick_bits) - 1) : tick;
}

/* Sends the frame of a scan with the faults of the line. */
static void put_scan(host *h, uint8_t *frame, size_t length)
{
    if (h->faulty && sensor_random(&h->sensor) < h->o.damage) {
        size_t place = (size_t)(sensor_random(&h->sensor) * (double)(length - 1));
        frame[place] = (uint8_t)(frame[place] ^ (frame[place] == 1 ? 2 : 1)); /* not the delimiter */
    }
    if (h->faulty && h->late_length == 0 && sensor_random(&h->sensor) < h->o.swap) {
        memcpy(h->late, frame, length);
        h->late_length = length;
        return;
    }
    put(h, frame, length);
    if (h->faulty && sensor_random(&h->sensor) < h->o.duplicate) {
        put(h, frame, length);
    }
    put(h, h->late, h->late_length);
    h->late_length = 0;
}

/* Acknowledges a command that nobody has sent. */
static void acknowledge_another(host *h)
{
    uint8_t message[TF_MAX_BODY], frame[TF_MAX_FRAME];
    size_t length = tf_write_ack(message, h->board.applied ^ 0x80000000u, TF_ACCEPTED);
    put(h, frame, tf_frame_encode(message, length, frame));
}

/* Sends a frame of the core, with the faults of a wrong firmware. */
static void put_frame(host *h, uint8_t *frame, size_t length)
{
    int type = frame[1]; /* after the COBS prefix */
    h->restarted = h->restarted || (type == TF_REPLY && h->board.started);
    if (type == h->o.mute) {
        return;
    }
    if (type == TF_ACK && h->o.wrong_ids > 0) {
        acknowledge_another(h);
    } else if (type == TF_SCAN || type == TF_LONG_SCAN) {
        put_scan(h, frame, length);
    } else {
        put(h, frame, length);
    }
}

/* Difference of the two clocks; of several readings, the one with the least time between them. */
static int64_t system_minus_monotonic(void)
{
    int64_t difference = 0, shortest = INT64_MAX;
    for (int i = 0; i < 20; i++) {
        int64_t before = clock_ns(CLOCK_MONOTONIC), system = clock_ns(CLOCK_REALTIME);
        int64_t span = clock_ns(CLOCK_MONOTONIC) - before;
        if (span < shortest) {
            shortest = span;
            difference = system - before - span / 2;
        }
    }
    return difference;
}

static void print_truth(const host *h, uint32_t sequence, double period_s, uint64_t tick)
{
    head_pose p = sensor_pose(&h->o, sequence * period_s);
    int64_t taken_ns = h->power_up_ns + (int64_t)((double)tick * tick_ns(h));
    long long time_ns = (long long)(taken_ns + h->system_ns);
    long long late_ns = (long long)(clock_ns(CLOCK_MONOTONIC) - taken_ns);
    printf("%lu %.12g %.12g %.12g %.12g %.12g %.12g %lld %lld %ld %ld %d\n", (unsigned long)sequence, p.t[0], p.t[1],
           p.t[2], p.roll, p.pitch, p.yaw, time_ns, late_ns, (long)h->board.outputs[0], (long)h->board.outputs[1],
           h->board.lease_expired);
    fflush(stdout);
}

uint64_t tf_port_now(void)
{
    return now(&the_host);
}

uint8_t tf_port_sample(uint64_t *tick, int32_t *codes)
{
    host *h = &the_host;
    double period_s = (double)h->board.period / TICK_HZ, command[2];
    for (int axis = 0; axis < 2; axis++) {
        command[axis] = h->outputs[axis] * FULL_SCALE_M / (1 << (OUTPUT_BITS - 1));
    }
    if (h->o.sequence_jump > 0 && h->board.sequence == h->o.at) {
        h->board.sequence += (uint32_t)h->o.sequence_jump; /* a fault: the core itself cannot do this */
    }
    uint32_t sequence = h->board.sequence;
    memcpy(codes, sensor_scan(&h->sensor, &h->o, sequence, period_s, command), SENSOR_CHANNELS * sizeof *codes);
    print_truth(h, sequence, period_s, *tick);
    *tick = stated_tick(h, *tick, sequence);
    h->faulty = sensor_faulty(&h->o, sequence);
    return 0;
}

void tf_port_output(const int32_t codes[2])
{
    the_host.outputs[0] = codes[0];
    the_host.outputs[1] = codes[1];
}

bool tf_port_send(uint8_t byte)
{
    host *h = &the_host;
    h->frame[h->frame_length++] = byte;
    if (byte == 0) {
        put_frame(h, h->frame, h->frame_length);
        h->frame_length = 0;
    }
    return true;
}

/* Takes bytes from the line. */
static void read_line(host *h)
{
    uint8_t bytes[256];
    ssize_t count;
    size_t room;
    while ((room = sizeof h->received / sizeof *h->received - h->received_length) > 0 &&
           (count = read(h->line, bytes, room < sizeof bytes ? room : sizeof bytes)) > 0) {
        int64_t arrival_ns = clock_ns(CLOCK_MONOTONIC) + (int64_t)(h->o.line_ms * 1e6);
        for (ssize_t i = 0; i < count; i++) {
            h->received[h->received_length++] = (travelling){bytes[i], arrival_ns};
        }
    }
}

bool tf_port_receive(uint8_t *byte)
{
    host *h = &the_host;
    if (h->taken == h->received_length || h->received[h->taken].arrival_ns > clock_ns(CLOCK_MONOTONIC)) {
        return false;
    }
    *byte = h->received[h->taken++].byte;
    h->identity.boot_id += h->o.new_boots > 0 ? 1 : 0;
    return true;
}

/* Waits for the line, the next scan or the end of the input; false at the end. */
static bool wait_for_work(const host *h)
{
    uint64_t tick;
    int64_t wait_ns = 1000000; /* the lease is checked once per millisecond */
    if (tf_board_next_scan(&h->board, &tick)) {
        int64_t until_ns = h->power_up_ns + (int64_t)((double)tick * tick_ns(h)) - clock_ns(CLOCK_MONOTONIC);
        wait_ns = until_ns < wait_ns ? until_ns : wait_ns;
    }
    struct pollfd ends[] = {{h->line, POLLIN, 0}, {STDIN_FILENO, POLLIN, 0}};
    poll(ends, 2, 0);
    bool request = (ends[0].revents & POLLIN) != 0; /* a hang-up is no request: no host has the line open */
    if (wait_ns > 0 && !request) {
        struct timespec pause = {0, wait_ns < LOOK_NS ? (long)wait_ns : LOOK_NS};
        nanosleep(&pause, NULL);
    }
    return ends[1].revents == 0;
}

/* A turn of the firmware, with the faults of a wrong one; false if there was nothing to do. */
static bool turn(host *h)
{
    tf_board *board = &h->board;
    uint32_t sequence = board->sequence;
    h->restarted = false;
    bool busy = tf_serve(board);
    if (h->restarted) {
        board->sequence = h->o.keep_number > 0 ? sequence + 1u : board->sequence;
        board->period = (uint32_t)((double)board->period / h->o.rate_factor);
    }
    board->lease_running = board->lease_running && h->o.no_lease <= 0;
    board->park_on_expiry = board->park_on_expiry && h->o.no_park <= 0;
    board->any_applied = board->any_applied && h->o.no_applied <= 0;
    return busy;
}

static void work(host *h)
{
    read_line(h);
    while (turn(h)) {
        flush(h);
    }
    flush(h);
    h->received_length -= h->taken;
    memmove(h->received, h->received + h->taken, h->received_length * sizeof *h->received);
    h->taken = 0;
}

int main(int count, char **arguments)
{
    if (count < 2) {
        fprintf(stderr, "usage: %s LINK [KEY=VALUE ...]\n", arguments[0]);
        return 64;
    }
    host *h = &the_host;
    h->o = options_read(count - 2, arguments + 2);
    h->power_up_ns = clock_ns(CLOCK_MONOTONIC);
    h->system_ns = system_minus_monotonic();
    h->identity = identity_of(&h->o);
    h->sensor.random = (uint64_t)h->o.seed;
    tf_board_init(&h->board, &h->identity);
    h->line = open_line(arguments[1]);
    puts("ready");
    fflush(stdout);
    while (wait_for_work(h)) {
        work(h);
    }
    return 0;
}
