/* Framing of the board protocol (docs/board-protocol.md, "Frames"): CRC-32, COBS, one zero byte after each frame.
 *
 * The functions use no memory other than that of their arguments, no clock and no library. They may be called from
 * an interrupt handler as long as no two calls share an object.
 */
#ifndef TF_FRAME_H
#define TF_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Largest message in bytes, checksum included. */
#define TF_MAX_MESSAGE 250u
/* Bytes of the checksum. */
#define TF_CRC 4u
/* Largest message without its checksum. */
#define TF_MAX_BODY (TF_MAX_MESSAGE - TF_CRC)
/* Largest frame: COBS adds one byte, the delimiter is another one. */
#define TF_MAX_FRAME (TF_MAX_MESSAGE + 2u)

/* CRC-32 of Ethernet, zlib and PNG. */
uint32_t tf_crc32(const uint8_t *bytes, size_t length);

/* Writes the frame of a message (type, version, body; without checksum) to `frame`, which has room for
 * TF_MAX_FRAME bytes; the message may be there already, from the second byte on. Returns the length of the frame with
 * its delimiter, or 0 if the message has more than TF_MAX_BODY bytes. */
size_t tf_frame_encode(const uint8_t *message, size_t length, uint8_t *frame);

/* What a byte of the line has completed. */
typedef enum {
    TF_FRAME_PART,    /* nothing yet */
    TF_FRAME_MESSAGE, /* a message is complete: `bytes` holds `length` bytes without checksum until the next call */
    TF_FRAME_DAMAGED  /* a frame has ended that is too long, or whose COBS encoding or checksum is wrong */
} tf_frame_event;

/* Receiver of frames. All bytes zero is its initial state. */
typedef struct {
    uint8_t bytes[TF_MAX_MESSAGE + 1u];
    size_t received; /* bytes of the current frame; more than the buffer if the frame is too long */
    size_t length;   /* of the last message, without checksum */
} tf_receiver;

/* Takes one byte of the line. Empty frames are ignored. */
tf_frame_event tf_frame_receive(tf_receiver *receiver, uint8_t byte);

#endif
