/* Messages of the board protocol, version 1.1: requests of the host are read, answers of the board are written.
 *
 * A message is type, version and body, without the checksum, which belongs to the framing.
 */
#ifndef TF_MESSAGE_H
#define TF_MESSAGE_H

#include "frame.h"

#define TF_VERSION 1u
#define TF_MAX_CHANNELS 16u
#define TF_MAX_NAME 64u
#define TF_MAX_UNITS 7u
/* Highest minor version that the core speaks. */
#define TF_MINOR 1u

/* Types of messages. */
enum {
    TF_IDENTIFY = 0x01,
    TF_START = 0x02,
    TF_STOP = 0x03,
    TF_STEER = 0x04,
    TF_IDENTITY = 0x81,
    TF_REPLY = 0x82,
    TF_ACK = 0x83,
    TF_SCAN = 0x84,
    TF_ERROR = 0x85,
    TF_LONG_SCAN = 0x86 /* 1.1 */
};

/* Roles of channels; PSD A, B, C are + 0, 1, 2, axes x, y of the readback + 0, 1. */
enum { TF_ROLE_AUXILIARY = 0x00, TF_ROLE_U = 0x10, TF_ROLE_V = 0x20, TF_ROLE_SUM = 0x30, TF_ROLE_READBACK = 0x40 };

/* Results in REPLY. */
enum { TF_DONE = 0, TF_RATE_OUT_OF_RANGE = 1, TF_PARK_OUT_OF_RANGE = 2 };

/* Results in ACK. */
enum { TF_ACCEPTED = 0, TF_OUT_OF_RANGE = 1, TF_NOT_STARTED = 2 };

/* Reasons in ERROR. */
enum { TF_ERROR_FRAME = 1, TF_ERROR_TYPE = 2, TF_ERROR_VERSION = 3, TF_ERROR_LENGTH = 4, TF_ERROR_VALUE = 5 };

/* Bits of the status of a SCAN; the last two of a LONG_SCAN only. */
enum { TF_AT_LIMIT = 1, TF_LEASE_EXPIRED = 2, TF_OVERRUN = 4, TF_APPLIED = 8, TF_WIDE_TICK = 16 };

/* Units of channels that carry no signal of the sensor. */
enum {
    TF_UNIT_ONE = 0,
    TF_UNIT_VOLT = 1,
    TF_UNIT_AMPERE = 2,
    TF_UNIT_CELSIUS = 3,
    TF_UNIT_PASCAL = 4,
    TF_UNIT_PERCENT = 5,
    TF_UNIT_WATT = 6,
    TF_UNIT_METRE = 7,
    TF_UNIT_ACCELERATION = 8, /* metre per second squared */
    TF_UNIT_HERTZ = 9
};

/* A request of the host. Only the fields of its type have a meaning. */
typedef struct {
    uint8_t type;       /* TF_IDENTIFY to TF_STEER */
    uint8_t minor;      /* IDENTIFY: highest minor version of the host; START: that of the scans. 0 if absent */
    uint32_t rate_mhz;  /* START: scans per 1000 seconds */
    int32_t codes[2];   /* START: parking position; STEER: position */
    uint32_t id;        /* STEER: number of the command */
    uint16_t lease_ms;  /* STEER: validity, milliseconds */
    bool park;          /* STEER: park when the lease expires, otherwise hold */
} tf_request;

/* Reads a message of the host as a board of version 1.`minor`. Returns 0 and fills `request`, or returns the reason for
 * an ERROR: the first that applies of version, type, length, value. */
uint8_t tf_request_read(const uint8_t *message, size_t length, uint8_t minor, tf_request *request);

/* A channel of the converter. */
typedef struct {
    uint8_t role;
    uint32_t skew_ns; /* from the tick of the scan to the sampling of this channel */
} tf_channel;

/* What the codes of a channel mean: (code - zero) * scale * 10^exponent, in this unit. */
typedef struct {
    uint8_t channel;  /* index in `channel` of the identity */
    uint8_t unit;     /* TF_UNIT_ONE to TF_UNIT_HERTZ */
    int32_t scale;
    int8_t exponent;
    int32_t zero;     /* 24 bits */
} tf_unit;

/* What a board is. */
typedef struct {
    uint32_t tick_hz;       /* ticks of the clock per second, 10 000 to 1 000 000 000 */
    uint8_t converter_bits; /* 8 to 24, sign included */
    uint8_t output_bits;    /* 8 to 24, sign included */
    uint32_t range_mv;      /* full scale of the converter, millivolts */
    uint32_t slowest_mhz;   /* limits of the rate, scans per 1000 seconds */
    uint32_t fastest_mhz;
    bool simulated;         /* the light is simulated */
    uint8_t channels;       /* 9 to TF_MAX_CHANNELS */
    tf_channel channel[TF_MAX_CHANNELS];
    const char *name;       /* UTF-8, at most TF_MAX_NAME bytes */

    uint8_t minor;          /* minor version that the board speaks, 0 or 1; the rest belongs to version 1.1 */
    bool wide_tick;         /* the tick of LONG_SCAN has 64 bits */
    uint32_t boot_id;       /* differs from power-up to power-up: a random number, or a counter in flash memory */
    uint8_t units;          /* number of entries in `unit`, 0 to TF_MAX_UNITS */
    tf_unit unit[TF_MAX_UNITS];
} tf_identity;

/* Each function writes a message to `message`, which has room for TF_MAX_BODY bytes, and returns its length. */
/* `host` is the minor version that IDENTIFY states. */
size_t tf_write_identity(uint8_t *message, const tf_identity *identity, uint8_t host);
size_t tf_write_reply(uint8_t *message, uint8_t request, uint8_t result, uint32_t rate_mhz);
size_t tf_write_ack(uint8_t *message, uint32_t id, uint8_t result);
size_t tf_write_scan(uint8_t *message, uint32_t sequence, uint32_t tick, uint8_t status, const int32_t *codes,
                     uint8_t channels);
/* A scan of version 1.1; the tick has 64 bits if `status` contains TF_WIDE_TICK. */
size_t tf_write_long_scan(uint8_t *message, uint32_t sequence, uint64_t tick, uint8_t status, uint32_t applied,
                          const int32_t *codes, uint8_t channels);
size_t tf_write_error(uint8_t *message, uint8_t reason, uint8_t type);

#endif
