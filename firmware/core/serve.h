/* The loop of a firmware, and the five functions through which it reaches the hardware.
 *
 * A port supplies the functions of the first part and calls tf_serve without end:
 *
 *     tf_board_init(&board, &identity);
 *     for (;;) {
 *         tf_serve(&board);
 *     }
 *
 * The loop runs in one thread. Interrupt handlers of the port may put bytes of the line and codes of the converter into
 * buffers from which these functions take them; they do not touch the board.
 */
#ifndef TF_SERVE_H
#define TF_SERVE_H

#include "board.h"

/* Ticks since power-up. 64 bits never wrap: a port counts the overflows of a shorter counter. */
uint64_t tf_port_now(void);

/* Stores the codes of the conversion at this tick, in the order of the channels of the identity, and returns a sum of
 * TF_AT_LIMIT and TF_OVERRUN. `*tick` is the tick at which the scan was due; a port whose hardware has latched another
 * one stores that. Called when the tick has passed. */
uint8_t tf_port_sample(uint64_t *tick, int32_t *codes);

/* Sets the two steering outputs. Called in every turn, also with codes that have not changed. */
void tf_port_output(const int32_t codes[2]);

/* Takes the next byte that has arrived from the host; false if there is none. */
bool tf_port_receive(uint8_t *byte);

/* Sends a byte to the host; false if the line has no room for it now. Does not wait. */
bool tf_port_send(uint8_t byte);

/* One turn: the scan that is due, otherwise a byte from the host; then lease, outputs, and bytes to the host. Returns
 * whether there was a scan or a byte. The lease expires as late as the turns are apart: 1 ms at most. */
bool tf_serve(tf_board *board);

#endif
