/* Clock, timer and UART0 of the LM3S6965 (data sheet DS-LM3S6965; names of registers as there). */
#ifndef HARDWARE_H
#define HARDWARE_H

#include <stdbool.h>
#include <stdint.h>

#define SYSTEM_HZ 12500000u
#define BAUD 460800u

#define UART0_INTERRUPT 5
#define TIMER0A_INTERRUPT 19
#define INTERRUPTS 44

/* Starts everything below. */
void hardware_init(void);

/* Ticks of SYSTEM_HZ since hardware_init. Must be called at least once per second. */
uint64_t hardware_now(void);

/* The next byte from UART0; false if there is none. */
bool hardware_receive(uint8_t *byte);

/* Passes a byte to UART0; false while its buffer is full. */
bool hardware_send(uint8_t byte);

/* Sleeps until a byte arrives, 250 us at most. */
void hardware_sleep(void);

void uart_interrupt(void);
void timer_interrupt(void);

#endif
