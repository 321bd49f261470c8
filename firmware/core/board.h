/* The board of docs/board-protocol.md without its hardware: conversation, schedule of the scans, steering, lease.
 *
 * A firmware drives it through serve.h. All functions take the time as an argument, finish in bounded time, and
 * allocate nothing. They must not be interrupted by each other, and are called in the order of their times: a scan
 * before a request that arrives after its tick. A scan then names the last command that the outputs had taken over at
 * its tick.
 */
#ifndef TF_BOARD_H
#define TF_BOARD_H

#include "message.h"

/* Bytes that wait for the line: room for one answer of each kind (300 bytes), and for scans. A firmware with long
 * pauses between two turns of its loop defines a larger value. */
#ifndef TF_TRANSMIT
#define TF_TRANSMIT 1024u
#endif

/* The state of a board. The firmware reads `started` and `outputs`, and writes nothing. */
typedef struct {
    const tf_identity *identity;
    tf_receiver receiver;

    bool started;
    bool long_scans;       /* the host has started scans of version 1.1 */
    uint32_t sequence;     /* of the next scan */
    uint64_t next_scan;    /* tick of the next scan */
    uint32_t period;       /* ticks from scan to scan */

    int32_t outputs[2];    /* codes of the steering outputs */
    int32_t park[2];
    bool lease_running, lease_expired, park_on_expiry;
    uint64_t lease_end;    /* tick */
    bool any_applied;      /* a command has been applied since power-up */
    uint32_t applied;      /* its id */

    uint8_t transmit[TF_TRANSMIT]; /* ring */
    size_t waiting_from, waiting;
    uint32_t omitted;      /* scans that found no room in the ring */
} tf_board;

/* The state after power-up. `identity` must exist as long as the board. */
void tf_board_init(tf_board *board, const tf_identity *identity);

/* Takes a byte of the line at this time. */
void tf_board_receive(tf_board *board, uint8_t byte, uint64_t now);

/* Whether a scan has to be taken, and at which tick. */
bool tf_board_next_scan(const tf_board *board, uint64_t *tick);

/* Sends the scan that was taken at `tick`; `codes` in the order of the channels of the identity, `status` of
 * TF_AT_LIMIT and TF_OVERRUN. If the ring is full, the scan is omitted and its number is consumed. */
void tf_board_scan(tf_board *board, uint64_t tick, const int32_t *codes, uint8_t status);

/* Lets the lease expire when its time has come. */
void tf_board_check_lease(tf_board *board, uint64_t now);

/* Whether a byte waits for the line, and which. */
bool tf_board_waiting(const tf_board *board, uint8_t *byte);

/* The byte that waits has been sent. */
void tf_board_sent(tf_board *board);

#endif
