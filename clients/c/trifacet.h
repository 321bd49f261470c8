/*
 * trifacet.h: decodes the pose frames of a trifacet daemon. One header, C99, no allocation, no dependencies.
 *
 *     struct trifacet_frame frame;
 *     if (trifacet_decode(&frame, bytes, length) == TRIFACET_OK
 *         && trifacet_usable(&frame, trifacet_age_ns(&frame, now_utc_ns), 20000000)) ...
 *
 * Units are metres, radians, watts and nanoseconds; unknown numbers are NaN. docs/stream.md describes every
 * field. docs/clients.md describes what to check before a machine acts on a pose. The decoder reads single
 * bytes, so it works with any byte order and alignment. float and double must be IEEE 754.
 */
#ifndef TRIFACET_H
#define TRIFACET_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define TRIFACET_MAJOR 1
#define TRIFACET_FRAME_SIZE 192
#define TRIFACET_CLOCK_UNKNOWN 65535u

/* Status bits. */
#define TRIFACET_POSE_VALID        (UINT32_C(1) << 0)
#define TRIFACET_PSD_A_LOW         (UINT32_C(1) << 1)
#define TRIFACET_PSD_B_LOW         (UINT32_C(1) << 2)
#define TRIFACET_PSD_C_LOW         (UINT32_C(1) << 3)
#define TRIFACET_PSD_A_CLIPPED     (UINT32_C(1) << 4)
#define TRIFACET_PSD_B_CLIPPED     (UINT32_C(1) << 5)
#define TRIFACET_PSD_C_CLIPPED     (UINT32_C(1) << 6)
#define TRIFACET_PSD_A_EDGE        (UINT32_C(1) << 7)
#define TRIFACET_PSD_B_EDGE        (UINT32_C(1) << 8)
#define TRIFACET_PSD_C_EDGE        (UINT32_C(1) << 9)
#define TRIFACET_UNBALANCED        (UINT32_C(1) << 10)
#define TRIFACET_NOT_LOCKED        (UINT32_C(1) << 11)
#define TRIFACET_STEERING_RAILED   (UINT32_C(1) << 12)
#define TRIFACET_NOT_CONVERGED     (UINT32_C(1) << 13)
#define TRIFACET_OUT_OF_RANGE      (UINT32_C(1) << 14)
#define TRIFACET_SAMPLE_GAP        (UINT32_C(1) << 15)
#define TRIFACET_SOURCE_DOWN       (UINT32_C(1) << 16)
#define TRIFACET_CLOCK_UNSYNCED    (UINT32_C(1) << 17)
#define TRIFACET_UNCALIBRATED      (UINT32_C(1) << 18)
#define TRIFACET_INCONSISTENT      (UINT32_C(1) << 19)
#define TRIFACET_SIMULATED         (UINT32_C(1) << 20)
#define TRIFACET_REPLAYED          (UINT32_C(1) << 21)
#define TRIFACET_POSE_HELD         (UINT32_C(1) << 22)
#define TRIFACET_STEERING_MEASURED (UINT32_C(1) << 23)
#define TRIFACET_RECORDING_FAULT   (UINT32_C(1) << 24)
#define TRIFACET_POWER_STEP        (UINT32_C(1) << 25)
#define TRIFACET_CHANNEL_FROZEN    (UINT32_C(1) << 26)
#define TRIFACET_POWER_NOISY       (UINT32_C(1) << 27)
#define TRIFACET_OUT_OF_CALIBRATION (UINT32_C(1) << 28)

/* Bits with which a pose is not usable for control: it contradicts another signal, its stated uncertainty does not
 * hold because a spot is outside the calibrated area, its time is unknown, it is an earlier one, or its light was not
 * measured now. */
#define TRIFACET_UNUSABLE \
    (TRIFACET_INCONSISTENT | TRIFACET_OUT_OF_CALIBRATION | TRIFACET_CLOCK_UNSYNCED | TRIFACET_POSE_HELD | \
     TRIFACET_NOT_REAL)

/* The light is computed or recorded, not measured: never control a machine with such a pose. To test a program
 * with the daemon's digital twin, define this as 0 before the header is included. */
#ifndef TRIFACET_NOT_REAL
#define TRIFACET_NOT_REAL (TRIFACET_SIMULATED | TRIFACET_REPLAYED)
#endif

/* Lock states, as in the field `lock`. */
enum trifacet_lock {
    TRIFACET_LOCK_OFF = 0,
    TRIFACET_LOCK_MANUAL = 1,
    TRIFACET_LOCK_SEARCHING = 2,
    TRIFACET_LOCK_ACQUIRING = 3,
    TRIFACET_LOCK_LOCKED = 4,
    TRIFACET_LOCK_RAILED = 5,
    TRIFACET_LOCK_LOST = 6,
    TRIFACET_LOCK_HELD = 7
};

/* The frame with the layout of the stream, in the byte order of the machine. */
struct trifacet_frame {
    uint8_t magic[4];
    uint8_t major;
    uint8_t minor;
    uint16_t size;
    uint32_t session;           /* a different number: the daemon was restarted, or its clock was set */
    uint32_t config;            /* a different number: other geometry or calibration */
    uint64_t sequence;          /* a gap is a loss */
    uint64_t sample_index;
    int64_t time_ns;            /* time at which the light was measured, UTC since 1970 */
    uint32_t solve_delay_ns;
    uint32_t send_delay_ns;
    uint32_t status;            /* TRIFACET_POSE_VALID and the others */
    uint16_t clock_quality;     /* 100 ns */
    uint8_t lock;               /* enum trifacet_lock */
    uint8_t iterations;
    double position[3];         /* tx, ty, tz */
    double rotation[3];         /* roll, pitch, yaw */
    float sd_position[3];
    float sd_rotation[3];
    float beam_offset[2];
    float steering_residual;
    uint16_t averaged;
    uint16_t lost;
    float spot_a[2];
    float spot_b[2];
    float spot_c[2];
    float power_a;
    float power_b;
    float power_c;
    float steering_x;
    float steering_y;
    uint32_t crc;
};

/* C99 has no static assertion; an array of negative size has the same effect. */
#define TRIFACET_ASSERT(name, condition) typedef char trifacet_assert_##name[(condition) ? 1 : -1]
TRIFACET_ASSERT(frame_size, sizeof(struct trifacet_frame) == TRIFACET_FRAME_SIZE);
TRIFACET_ASSERT(position, offsetof(struct trifacet_frame, position) == 56);
TRIFACET_ASSERT(spot_a, offsetof(struct trifacet_frame, spot_a) == 144);
TRIFACET_ASSERT(crc, offsetof(struct trifacet_frame, crc) == 188);
TRIFACET_ASSERT(float_size, sizeof(float) == 4 && sizeof(double) == 8);

/* Results of trifacet_decode(). */
enum trifacet_result {
    TRIFACET_OK = 0,
    TRIFACET_BAD_LENGTH,  /* not 192 bytes, or a different size in the frame */
    TRIFACET_BAD_MAGIC,   /* not a pose frame */
    TRIFACET_BAD_VERSION, /* another major version: frames of this daemon cannot be decoded */
    TRIFACET_BAD_CRC,     /* damaged in transmission */
    TRIFACET_BAD_LOCK     /* a lock state that does not exist */
};

static inline uint16_t trifacet_u16(const uint8_t *p)
{
    return (uint16_t)(p[0] | p[1] << 8);
}

static inline uint32_t trifacet_u32(const uint8_t *p)
{
    return (uint32_t)trifacet_u16(p) | (uint32_t)trifacet_u16(p + 2) << 16;
}

static inline uint64_t trifacet_u64(const uint8_t *p)
{
    return (uint64_t)trifacet_u32(p) | (uint64_t)trifacet_u32(p + 4) << 32;
}

static inline float trifacet_f32(const uint8_t *p)
{
    uint32_t bits = trifacet_u32(p);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline double trifacet_f64(const uint8_t *p)
{
    uint64_t bits = trifacet_u64(p);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline void trifacet_f32s(float *to, const uint8_t *p, int count)
{
    for (int i = 0; i < count; i++)
        to[i] = trifacet_f32(p + 4 * i);
}

static inline void trifacet_f64s(double *to, const uint8_t *p, int count)
{
    for (int i = 0; i < count; i++)
        to[i] = trifacet_f64(p + 8 * i);
}

/* CRC-32 as in zlib and Ethernet. Processes 4 bits per step, so the table needs 64 bytes instead of 1024. */
static inline uint32_t trifacet_crc32(const uint8_t *bytes, size_t length)
{
    static const uint32_t table[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
        0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu, 0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu,
    };
    uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < length; i++) {
        crc = table[(crc ^ bytes[i]) & 15] ^ crc >> 4;
        crc = table[(crc ^ bytes[i] >> 4) & 15] ^ crc >> 4;
    }
    return ~crc;
}

/* Decodes a frame. Writes `frame` only if the bytes are a complete, undamaged frame. */
static inline enum trifacet_result trifacet_decode(struct trifacet_frame *frame, const uint8_t *bytes, size_t length)
{
    if (length < 8)
        return TRIFACET_BAD_LENGTH;
    if (memcmp(bytes, "TFP1", 4) != 0)
        return TRIFACET_BAD_MAGIC;
    if (bytes[4] != TRIFACET_MAJOR)
        return TRIFACET_BAD_VERSION;
    if (length != TRIFACET_FRAME_SIZE || trifacet_u16(bytes + 6) != TRIFACET_FRAME_SIZE)
        return TRIFACET_BAD_LENGTH;
    if (trifacet_crc32(bytes, 188) != trifacet_u32(bytes + 188))
        return TRIFACET_BAD_CRC;
    if (bytes[54] > TRIFACET_LOCK_HELD)
        return TRIFACET_BAD_LOCK;

    memcpy(frame->magic, bytes, 4);
    frame->major = bytes[4];
    frame->minor = bytes[5];
    frame->size = trifacet_u16(bytes + 6);
    frame->session = trifacet_u32(bytes + 8);
    frame->config = trifacet_u32(bytes + 12);
    frame->sequence = trifacet_u64(bytes + 16);
    frame->sample_index = trifacet_u64(bytes + 24);
    frame->time_ns = (int64_t)trifacet_u64(bytes + 32);
    frame->solve_delay_ns = trifacet_u32(bytes + 40);
    frame->send_delay_ns = trifacet_u32(bytes + 44);
    frame->status = trifacet_u32(bytes + 48);
    frame->clock_quality = trifacet_u16(bytes + 52);
    frame->lock = bytes[54];
    frame->iterations = bytes[55];
    trifacet_f64s(frame->position, bytes + 56, 3);
    trifacet_f64s(frame->rotation, bytes + 80, 3);
    trifacet_f32s(frame->sd_position, bytes + 104, 3);
    trifacet_f32s(frame->sd_rotation, bytes + 116, 3);
    trifacet_f32s(frame->beam_offset, bytes + 128, 2);
    frame->steering_residual = trifacet_f32(bytes + 136);
    frame->averaged = trifacet_u16(bytes + 140);
    frame->lost = trifacet_u16(bytes + 142);
    trifacet_f32s(frame->spot_a, bytes + 144, 2);
    trifacet_f32s(frame->spot_b, bytes + 152, 2);
    trifacet_f32s(frame->spot_c, bytes + 160, 2);
    frame->power_a = trifacet_f32(bytes + 168);
    frame->power_b = trifacet_f32(bytes + 172);
    frame->power_c = trifacet_f32(bytes + 176);
    frame->steering_x = trifacet_f32(bytes + 180);
    frame->steering_y = trifacet_f32(bytes + 184);
    frame->crc = trifacet_u32(bytes + 188);
    return TRIFACET_OK;
}

/* Nanoseconds since the light was measured. Requires that both machines have the same UTC (NTP or PTP); a
 * negative result shows that they have not. */
static inline int64_t trifacet_age_ns(const struct trifacet_frame *frame, int64_t now_utc_ns)
{
    /* Unsigned arithmetic, because an invalid time must not cause an overflow. */
    return (int64_t)((uint64_t)now_utc_ns - (uint64_t)frame->time_ns);
}

/* The same without a common clock: `waited_ns` is the time since the frame arrived, on any clock of this
 * machine. The network delay is not included. Count from the last moment at which the socket was known to be
 * empty: a frame that waited in its buffer arrived after that moment, at an unknown time. */
static inline int64_t trifacet_local_age_ns(const struct trifacet_frame *frame, int64_t waited_ns)
{
    return waited_ns + (int64_t)frame->send_delay_ns;
}

/* Whether a machine may act on this pose: it is valid, no bit of TRIFACET_UNUSABLE is set, and its age is within
 * plus and minus the limit. The status is checked first, because the numbers of an invalid frame are NaN. Whether
 * the beam is on the apex is a separate question: see `lock`. */
static inline int trifacet_usable(const struct trifacet_frame *frame, int64_t age_ns, int64_t max_age_ns)
{
    return (frame->status & TRIFACET_POSE_VALID) != 0 && (frame->status & TRIFACET_UNUSABLE) == 0
        && age_ns <= max_age_ns && age_ns >= -max_age_ns;
}

/* Counts losses from the sequence numbers. Initialise with zero. With a divider in the daemon's configuration, only
 * frames whose sequence number is a multiple of it are sent: set `divider` to the same value. */
struct trifacet_losses {
    uint32_t divider; /* 0 means 1 */
    uint32_t session;
    uint64_t missed;  /* frames missing in the sequence */
    uint64_t late;    /* frames that arrived after a newer one, or twice; a late frame was counted as missed before */
    uint64_t last;
    int started;
};

/* Call this for every decoded frame. The result is false if a newer frame has arrived before: do not use this one. */
static inline int trifacet_in_order(struct trifacet_losses *losses, const struct trifacet_frame *frame)
{
    uint64_t number = frame->sequence / (losses->divider ? losses->divider : 1);
    if (losses->started && losses->session == frame->session) {
        if (number <= losses->last) {
            losses->late++;
            return 0;
        }
        losses->missed += number - losses->last - 1;
    }
    losses->started = 1;
    losses->session = frame->session; /* a different number: a new sequence */
    losses->last = number;
    return 1;
}

#endif
