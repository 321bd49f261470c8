#include "message.h"

static uint32_t read_u32(const uint8_t *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* Two's complement without a conversion that C leaves to the compiler. */
static int32_t read_i32(const uint8_t *at)
{
    uint32_t bits = read_u32(at);
    return bits <= 0x7FFFFFFFu ? (int32_t)bits : -(int32_t)(0xFFFFFFFFu - bits) - 1;
}

/* Length of a request without checksum; 0 for an unknown type. */
static size_t length_of(uint8_t type)
{
    switch (type) {
    case TF_IDENTIFY:
    case TF_STOP:
        return 2;
    case TF_START:
        return 14;
    case TF_STEER:
        return 17;
    default:
        return 0;
    }
}

/* Whether a request ends with a minor version. */
static bool takes_minor(uint8_t type)
{
    return type == TF_IDENTIFY || type == TF_START;
}

uint8_t tf_request_read(const uint8_t *message, size_t length, uint8_t minor, tf_request *request)
{
    if (length < 2u) {
        return TF_ERROR_LENGTH;
    }
    if (message[1] != TF_VERSION) {
        return TF_ERROR_VERSION;
    }
    size_t expected = length_of(message[0]);
    if (expected == 0u) {
        return TF_ERROR_TYPE;
    }
    bool states_minor = minor > 0u && takes_minor(message[0]) && length == expected + 1u;
    if (length != expected && !states_minor) {
        return TF_ERROR_LENGTH;
    }
    request->type = message[0];
    request->minor = states_minor ? message[expected] : 0u;
    if (request->type == TF_START) {
        if (request->minor > TF_MINOR) {
            return TF_ERROR_VALUE;
        }
        request->rate_mhz = read_u32(message + 2);
        request->codes[0] = read_i32(message + 6);
        request->codes[1] = read_i32(message + 10);
    } else if (request->type == TF_STEER) {
        if (message[16] > 1u) {
            return TF_ERROR_VALUE;
        }
        request->id = read_u32(message + 2);
        request->codes[0] = read_i32(message + 6);
        request->codes[1] = read_i32(message + 10);
        request->lease_ms = (uint16_t)(message[14] | message[15] << 8);
        request->park = message[16] == 1u;
    }
    return 0;
}

/* The place of the next field of a message. */
typedef struct {
    uint8_t *message;
    size_t length;
} writer;

static void u8(writer *w, uint8_t x)
{
    w->message[w->length++] = x;
}

static void low_bytes(writer *w, uint32_t x, unsigned bytes)
{
    for (unsigned i = 0; i < bytes; i++) {
        u8(w, (uint8_t)(x >> (8u * i)));
    }
}

static writer begin(uint8_t *message, uint8_t type)
{
    writer w = {message, 0};
    u8(&w, type);
    u8(&w, TF_VERSION);
    return w;
}

static void write_extension(writer *w, const tf_identity *identity)
{
    uint8_t units = identity->units < TF_MAX_UNITS ? identity->units : (uint8_t)TF_MAX_UNITS;
    u8(w, identity->minor);
    u8(w, identity->wide_tick ? 64u : 32u);
    low_bytes(w, identity->boot_id, 4);
    u8(w, units);
    for (unsigned i = 0; i < identity->units && i < TF_MAX_UNITS; i++) {
        const tf_unit *unit = &identity->unit[i];
        u8(w, unit->channel);
        u8(w, unit->unit);
        low_bytes(w, (uint32_t)unit->scale, 4);
        u8(w, (uint8_t)unit->exponent);
        low_bytes(w, (uint32_t)unit->zero, 3);
    }
}

size_t tf_write_identity(uint8_t *message, const tf_identity *identity, uint8_t host)
{
    writer w = begin(message, TF_IDENTITY);
    low_bytes(&w, identity->tick_hz, 4);
    u8(&w, identity->converter_bits);
    u8(&w, identity->output_bits);
    low_bytes(&w, identity->range_mv, 4);
    low_bytes(&w, identity->slowest_mhz, 4);
    low_bytes(&w, identity->fastest_mhz, 4);
    u8(&w, (uint8_t)((identity->simulated ? 1u : 0u) | (identity->minor > 0u ? 2u : 0u)));
    u8(&w, identity->channels);
    for (unsigned i = 0; i < identity->channels && i < TF_MAX_CHANNELS; i++) {
        u8(&w, identity->channel[i].role);
        low_bytes(&w, identity->channel[i].skew_ns, 4);
    }
    uint8_t name = 0;
    while (name < TF_MAX_NAME && identity->name[name] != '\0') {
        name++;
    }
    u8(&w, name);
    for (unsigned i = 0; i < name; i++) {
        u8(&w, (uint8_t)identity->name[i]);
    }
    if (identity->minor > 0u && host > 0u) {
        write_extension(&w, identity);
    }
    return w.length;
}

size_t tf_write_reply(uint8_t *message, uint8_t request, uint8_t result, uint32_t rate_mhz)
{
    writer w = begin(message, TF_REPLY);
    u8(&w, request);
    u8(&w, result);
    low_bytes(&w, rate_mhz, 4);
    return w.length;
}

size_t tf_write_ack(uint8_t *message, uint32_t id, uint8_t result)
{
    writer w = begin(message, TF_ACK);
    low_bytes(&w, id, 4);
    u8(&w, result);
    return w.length;
}

static size_t write_codes(writer *w, const int32_t *codes, uint8_t channels)
{
    for (unsigned i = 0; i < channels && i < TF_MAX_CHANNELS; i++) {
        low_bytes(w, (uint32_t)codes[i], 3);
    }
    return w->length;
}

size_t tf_write_scan(uint8_t *message, uint32_t sequence, uint32_t tick, uint8_t status, const int32_t *codes,
                     uint8_t channels)
{
    writer w = begin(message, TF_SCAN);
    low_bytes(&w, sequence, 4);
    low_bytes(&w, tick, 4);
    u8(&w, status);
    return write_codes(&w, codes, channels);
}

size_t tf_write_long_scan(uint8_t *message, uint32_t sequence, uint64_t tick, uint8_t status, uint32_t applied,
                          const int32_t *codes, uint8_t channels)
{
    writer w = begin(message, TF_LONG_SCAN);
    low_bytes(&w, sequence, 4);
    u8(&w, status);
    low_bytes(&w, applied, 4);
    low_bytes(&w, (uint32_t)tick, 4);
    if ((status & TF_WIDE_TICK) != 0u) {
        low_bytes(&w, (uint32_t)(tick >> 32), 4);
    }
    return write_codes(&w, codes, channels);
}

size_t tf_write_error(uint8_t *message, uint8_t reason, uint8_t type)
{
    writer w = begin(message, TF_ERROR);
    u8(&w, reason);
    u8(&w, type);
    return w.length;
}
