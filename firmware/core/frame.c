#include "frame.h"

uint32_t tf_crc32(const uint8_t *bytes, size_t length)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc >> 1) ^ ((crc & 1u) != 0u ? 0xEDB88320u : 0u); /* 0x04C11DB7 reflected */
        }
    }
    return crc ^ 0xFFFFFFFFu;
}

/* State of an encoder: `code` is the place of the prefix of the current part. */
typedef struct {
    uint8_t *frame;
    size_t code, length;
} encoder;

static void end_part(encoder *e)
{
    e->frame[e->code] = (uint8_t)(e->length - e->code);
    e->code = e->length++;
}

static void put(encoder *e, uint8_t byte)
{
    if (byte == 0u) {
        end_part(e);
    } else {
        e->frame[e->length++] = byte; /* a part of a message of 250 bytes is shorter than 254 */
    }
}

size_t tf_frame_encode(const uint8_t *message, size_t length, uint8_t *frame)
{
    if (length > TF_MAX_BODY) {
        return 0;
    }
    encoder e = {frame, 0, 1};
    uint32_t crc = tf_crc32(message, length);
    for (size_t i = 0; i < length; i++) {
        put(&e, message[i]);
    }
    for (unsigned i = 0; i < TF_CRC; i++) {
        put(&e, (uint8_t)(crc >> (8u * i)));
    }
    end_part(&e);
    frame[e.code] = 0; /* the delimiter takes the place of the next prefix */
    return e.length;
}

/* Removes the COBS encoding in place. Returns false if a part is longer than the frame. */
static bool unstuff(uint8_t *bytes, size_t encoded, size_t *length)
{
    size_t from = 0, to = 0;
    while (from < encoded) {
        size_t part = bytes[from];
        if (part > encoded - from) {
            return false;
        }
        for (size_t i = 1; i < part; i++) {
            bytes[to++] = bytes[from + i];
        }
        from += part;
        if (from < encoded && part < 255u) {
            bytes[to++] = 0;
        }
    }
    *length = to;
    return true;
}

static tf_frame_event complete(tf_receiver *r, size_t received)
{
    size_t length;
    if (received > sizeof r->bytes || !unstuff(r->bytes, received, &length) || length < 2u + TF_CRC) {
        return TF_FRAME_DAMAGED;
    }
    r->length = length - TF_CRC;
    uint32_t crc = 0;
    for (unsigned i = 0; i < TF_CRC; i++) {
        crc |= (uint32_t)r->bytes[r->length + i] << (8u * i);
    }
    return crc == tf_crc32(r->bytes, r->length) ? TF_FRAME_MESSAGE : TF_FRAME_DAMAGED;
}

tf_frame_event tf_frame_receive(tf_receiver *r, uint8_t byte)
{
    if (byte != 0u) {
        if (r->received < sizeof r->bytes) {
            r->bytes[r->received] = byte;
        }
        if (r->received <= sizeof r->bytes) {
            r->received++;
        }
        return TF_FRAME_PART;
    }
    size_t received = r->received;
    r->received = 0;
    return received == 0u ? TF_FRAME_PART : complete(r, received);
}
