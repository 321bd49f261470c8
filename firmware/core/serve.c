#include "serve.h"

/* Takes the scan that is due; false if none is. */
static bool scan(tf_board *board)
{
    int32_t codes[TF_MAX_CHANNELS] = {0};
    uint64_t tick;
    if (!tf_board_next_scan(board, &tick) || tf_port_now() < tick) {
        return false;
    }
    tf_board_check_lease(board, tick); /* the status is that of the tick, however late this is */
    tf_port_output(board->outputs);
    uint8_t status = tf_port_sample(&tick, codes);
    tf_board_scan(board, tick, codes, status);
    return true;
}

/* Takes a byte from the host; false if none has arrived. */
static bool receive(tf_board *board)
{
    uint8_t byte;
    if (!tf_port_receive(&byte)) {
        return false;
    }
    tf_board_receive(board, byte, tf_port_now());
    return true;
}

static void transmit(tf_board *board)
{
    uint8_t byte;
    while (tf_board_waiting(board, &byte) && tf_port_send(byte)) {
        tf_board_sent(board);
    }
}

bool tf_serve(tf_board *board)
{
    bool busy = scan(board) || receive(board);
    tf_board_check_lease(board, tf_port_now());
    tf_port_output(board->outputs);
    transmit(board);
    return busy;
}
