#include "board.h"

/* Room that scans leave in the ring for answers. */
#define RESERVE (2u * TF_MAX_FRAME)

void tf_board_init(tf_board *board, const tf_identity *identity)
{
    static const tf_board at_power_up;
    *board = at_power_up;
    board->identity = identity;
}

static bool has_room(const tf_board *board, size_t length, size_t reserve)
{
    return board->waiting + length + reserve <= TF_TRANSMIT;
}

/* Sends a message; false if the ring has no room for it. */
static bool send(tf_board *board, const uint8_t *message, size_t length, size_t reserve)
{
    uint8_t frame[TF_MAX_FRAME];
    size_t bytes = tf_frame_encode(message, length, frame);
    if (bytes == 0u || !has_room(board, bytes, reserve)) {
        return false;
    }
    for (size_t i = 0; i < bytes; i++) {
        board->transmit[(board->waiting_from + board->waiting++) % TF_TRANSMIT] = frame[i];
    }
    return true;
}

static void answer(tf_board *board, const uint8_t *message, size_t length)
{
    /* A host that sends more requests than the line can answer repeats them (step 1 of the conversation). */
    (void)send(board, message, length, 0);
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

static void execute(tf_board *board, const tf_request *request, uint64_t now)
{
    uint8_t message[TF_MAX_BODY], result;
    size_t length;
    switch (request->type) {
    case TF_START:
        result = start(board, request, now);
        length = tf_write_reply(message, TF_START, result, stated_rate(board));
        break;
    case TF_STOP:
        board->started = false;
        length = tf_write_reply(message, TF_STOP, TF_DONE, 0);
        break;
    case TF_STEER:
        length = tf_write_ack(message, request->id, steer(board, request, now));
        break;
    default: /* IDENTIFY */
        length = tf_write_identity(message, board->identity, request->minor);
        break;
    }
    answer(board, message, length);
}

void tf_board_receive(tf_board *board, uint8_t byte, uint64_t now)
{
    uint8_t message[TF_MAX_BODY];
    tf_board_check_lease(board, now); /* a command that comes too late does not renew its predecessor */
    switch (tf_frame_receive(&board->receiver, byte)) {
    case TF_FRAME_DAMAGED:
        answer(board, message, tf_write_error(message, TF_ERROR_FRAME, 0));
        break;
    case TF_FRAME_MESSAGE: {
        tf_request request;
        uint8_t reason = tf_request_read(board->receiver.bytes, board->receiver.length, board->identity->minor,
                                         &request);
        if ((board->receiver.bytes[0] & 0x80u) != 0u) {
            break; /* from a board: the line echoes. An answer would be echoed too, without end */
        }
        if (reason == 0u) {
            execute(board, &request, now);
        } else {
            answer(board, message, tf_write_error(message, reason, board->receiver.bytes[0]));
        }
        break;
    }
    default:
        break;
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
    uint8_t message[TF_MAX_BODY];
    if (!board->started) {
        return;
    }
    if (board->lease_expired) {
        status |= TF_LEASE_EXPIRED;
    }
    size_t length = write_scan(board, message, tick, codes, status);
    if (!send(board, message, length, RESERVE)) {
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

size_t tf_board_transmit(tf_board *board, uint8_t *bytes, size_t room)
{
    size_t taken = 0;
    while (taken < room && board->waiting > 0u) {
        bytes[taken++] = board->transmit[board->waiting_from];
        board->waiting_from = (board->waiting_from + 1u) % TF_TRANSMIT;
        board->waiting--;
    }
    return taken;
}
