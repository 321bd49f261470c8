/* Vectors and start of the LM3S6965. */
#include <stddef.h>
#include <stdint.h>

#include "hardware.h"

/* Of the linker script. */
extern uint32_t data_begin[], data_end[], bss_begin[], bss_end[], stack_top[];
extern const uint32_t data_in_flash[];

int main(void);
void reset(void);

void reset(void)
{
    /* cppcheck-suppress comparePointers ; the linker places both into one section */
    for (size_t i = 0; data_begin + i < data_end; i++) {
        data_begin[i] = data_in_flash[i];
    }
    /* cppcheck-suppress comparePointers ; the same */
    for (uint32_t *word = bss_begin; word < bss_end; word++) {
        *word = 0;
    }
    (void)main();
}

/* A fault stops the processor. The outputs of a real board fall back to their watchdog then. */
static void stop(void)
{
    for (;;) {
    }
}

typedef union {
    void (*handler)(void);
    uint32_t *stack;
} vector;

/* Exceptions 0 to 15, then the interrupts. */
__attribute__((section(".vectors"), used)) static const vector VECTORS[16 + INTERRUPTS] = {
    [0] = {.stack = stack_top},
    [1] = {.handler = reset},
    [2] = {.handler = stop},
    [3] = {.handler = stop},
    [4] = {.handler = stop},
    [5] = {.handler = stop},
    [6] = {.handler = stop},
    [16 + UART0_INTERRUPT] = {.handler = uart_interrupt},
    [16 + TIMER0A_INTERRUPT] = {.handler = timer_interrupt},
};
