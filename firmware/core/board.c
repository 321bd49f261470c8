#include "board.h"

/* Room that scans leave in the ring for one answer of each kind: IDENTITY, and three that are shorter than 16 bytes. */
#define RESERVE (TF_MAX_FRAME + 3u * 16u)

void tf_board_init(tf_board *board, const tf_identity *identity)
{
    *board = (tf_board){.identity = identity};
}

static bool has_room(const tf_board *board, size_t length, size_t reserve)
{
    return board->waiting + length + reserve <= TF_TRANSMIT;
}

/* A message with room for its frame around it. */
typedef struct {
    uint8_t frame[TF_MAX_FRAME];
    size_t length; /* of the message, which begins at the second byte of the frame */
} outgoing;

/* Sends a message; false if the ring has no room for it. */
static bool send(tf_board *board, outgoing *out, size_t reserve)
{
    size_t bytes = tf_frame_encode(out->frame + 1, out->length, out->frame);
    if (bytes == 0u || !has_room(board, bytes, reserve)) {
        return false;
    }
    for (size_t i = 0; i < bytes; i++) {
        board->transmit[(board->waiting_from + board->waiting++) % TF_TRANSMIT] = out->frame[i];
    }
    return true;
}

static bool in_range(const tf_board *board, const int32_t codes[2])
{
    int32_t limit = (int32_t)1 << (board->identity->output_bits - 1u);
    for (int axis = 0; axis < 2; axis++) {
        if (codes[axis] < -limit || codes[axis] >= limit) {
            return false;
        }
    }
    return true;
}

/* The period of the timer in ticks that is nearest to this rate. */
static uint32_t period_of(const tf_board *board, uint32_t rate_mhz)
{
    uint64_t ticks = (uint64_t)board->identity->tick_hz * 1000u;
    uint64_t period = (ticks + rate_mhz / 2u) / rate_mhz;
    return period == 0u ? 1u : (uint32_t)(period > UINT32_MAX ? UINT32_MAX : period);
}

static uint32_t rate_of(const tf_board *board)
{
    uint64_t ticks = (uint64_t)board->identity->tick_hz * 1000u;
    return (uint32_t)((ticks + board->period / 2u) / board->period);
}

static uint8_t start(tf_board *board, const tf_request *request, uint64_t now)
{
    const tf_identity *identity = board->identity;
    if (request->rate_mhz == 0u || request->rate_mhz < identity->slowest_mhz ||
        request->rate_mhz > identity->fastest_mhz) {
        return TF_RATE_OUT_OF_RANGE;
    }
    if (!in_range(board, request->codes)) {
        return TF_PARK_OUT_OF_RANGE;
    }
    board->started = true;
    board->long_scans = request->minor > 0u;
    board->sequence = 0;
    board->period = period_of(board, request->rate_mhz);
    board->next_scan = now + board->period;
    board->park[0] = request->codes[0];
    board->park[1] = request->codes[1];
    return TF_DONE;
}

static uint8_t steer(tf_board *board, const tf_request *request, uint64_t now)
{
    if (!board->started) {
        return TF_NOT_STARTED;
    }
    if (!in_range(board, request->codes) || request->lease_ms == 0u) {
        return TF_OUT_OF_RANGE;
    }
    board->outputs[0] = request->codes[0];
    board->outputs[1] = request->codes[1];
    board->park_on_expiry = request->park;
    board->any_applied = true;
    board->applied = request->id;
    board->lease_running = true;
    board->lease_expired = false;
    board->lease_end = now + (uint64_t)request->lease_ms * board->identity->tick_hz / 1000u;
    return TF_ACCEPTED;
}

/* The rate that a REPLY states. */
static uint32_t stated_rate(const tf_board *board)
{
    return board->started ? rate_of(board) : 0u;
}

/* Executes a request and writes its answer; returns the length of the answer. */
static size_t execute(tf_board *board, const tf_request *request, uint64_t now, uint8_t *message)
{
    uint8_t result;
    switch (request->type) {
    case TF_START:
        result = start(board, request, now);
        return tf_write_reply(message, TF_START, result, stated_rate(board));
    case TF_STOP:
        board->started = false;
        return tf_write_reply(message, TF_STOP, TF_DONE, 0);
    case TF_STEER:
        return tf_write_ack(message, request->id, steer(board, request, now));
    default: /* IDENTIFY */
        return tf_write_identity(message, board->identity, request->minor);
    }
}

/* The same for a message that has arrived; 0 if it gets no answer. */
static size_t take(tf_board *board, uint64_t now, uint8_t *message)
{
    const uint8_t *arrived = board->receiver.bytes;
    tf_request request;
    uint8_t reason = tf_request_read(arrived, board->receiver.length, board->identity->minor, &request);
    if ((arrived[0] & 0x80u) != 0u) {
        return 0; /* from a board: the line echoes. An answer would be echoed too, without end */
    }
    return reason == 0u ? execute(board, &request, now, message) : tf_write_error(message, reason, arrived[0]);
}

void tf_board_receive(tf_board *board, uint8_t byte, uint64_t now)
{
    outgoing answer;
    answer.length = 0;
    tf_board_check_lease(board, now); /* a command that comes too late does not renew its predecessor */
    switch (tf_frame_receive(&board->receiver, byte)) {
    case TF_FRAME_DAMAGED:
        answer.length = tf_write_error(answer.frame + 1, TF_ERROR_FRAME, 0);
        break;
    case TF_FRAME_MESSAGE:
        answer.length = take(board, now, answer.frame + 1);
        break;
    case TF_FRAME_PART:
        break;
    }
    if (answer.length > 0u) {
        /* A host that sends more requests than the line can answer repeats them (step 1 of the conversation). */
        (void)send(board, &answer, 0);
    }
}

bool tf_board_next_scan(const tf_board *board, uint64_t *tick)
{
    *tick = board->next_scan;
    return board->started;
}

static size_t write_scan(const tf_board *board, uint8_t *message, uint64_t tick, const int32_t *codes, uint8_t status)
{
    const tf_identity *identity = board->identity;
    if (!board->long_scans) {
        return tf_write_scan(message, board->sequence, (uint32_t)tick, status, codes, identity->channels);
    }
    status |= (uint8_t)((board->any_applied ? TF_APPLIED : 0) | (identity->wide_tick ? TF_WIDE_TICK : 0));
    return tf_write_long_scan(message, board->sequence, tick, status, board->applied, codes, identity->channels);
}

void tf_board_scan(tf_board *board, uint64_t tick, const int32_t *codes, uint8_t status)
{
    outgoing out;
    if (!board->started) {
        return;
    }
    if (board->lease_expired) {
        status |= TF_LEASE_EXPIRED;
    }
    out.length = write_scan(board, out.frame + 1, tick, codes, status);
    if (!send(board, &out, RESERVE)) {
        board->omitted++;
    }
    board->sequence++;
    board->next_scan += board->period;
}

void tf_board_check_lease(tf_board *board, uint64_t now)
{
    if (!board->lease_running || now < board->lease_end) {
        return;
    }
    board->lease_running = false;
    board->lease_expired = true;
    if (board->park_on_expiry) {
        board->outputs[0] = board->park[0];
        board->outputs[1] = board->park[1];
    }
}

bool tf_board_waiting(const tf_board *board, uint8_t *byte)
{
    *byte = board->transmit[board->waiting_from];
    return board->waiting > 0u;
}

void tf_board_sent(tf_board *board)
{
    board->waiting_from = (board->waiting_from + 1u) % TF_TRANSMIT;
    board->waiting--;
}
