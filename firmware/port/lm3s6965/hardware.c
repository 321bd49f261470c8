#include "hardware.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define RCC REGISTER(0x400FE060u)
#define RIS REGISTER(0x400FE050u)
#define RCGC1 REGISTER(0x400FE104u)
#define RCGC2 REGISTER(0x400FE108u)
#define GPIOA_AFSEL REGISTER(0x40004420u)
#define GPIOA_DEN REGISTER(0x4000451Cu)
#define UART0(offset) REGISTER(0x4000C000u + (offset))
#define UART0_DR UART0(0x00u)
#define UART0_FR UART0(0x18u)
#define UART0_IBRD UART0(0x24u)
#define UART0_FBRD UART0(0x28u)
#define UART0_LCRH UART0(0x2Cu)
#define UART0_CTL UART0(0x30u)
#define UART0_IM UART0(0x38u)
#define UART0_ICR UART0(0x44u)
#define TIMER0(offset) REGISTER(0x40030000u + (offset))
#define TIMER0_CFG TIMER0(0x00u)
#define TIMER0_TAMR TIMER0(0x04u)
#define TIMER0_CTL TIMER0(0x0Cu)
#define TIMER0_IMR TIMER0(0x18u)
#define TIMER0_ICR TIMER0(0x24u)
#define TIMER0_TAILR TIMER0(0x28u)
#define SYST_CSR REGISTER(0xE000E010u)
#define SYST_RVR REGISTER(0xE000E014u)
#define SYST_CVR REGISTER(0xE000E018u)
#define NVIC_ISER0 REGISTER(0xE000E100u)

#define BYPASS (1u << 11)
#define POWER_DOWN (1u << 13)
#define USE_DIVIDER (1u << 22)
#define PLL_LOCKED (1u << 6)
#define RECEIVER_EMPTY (1u << 4)
#define TRANSMITTER_FULL (1u << 5)
#define RECEIVED (1u << 4 | 1u << 6) /* interrupts: bytes, and a pause after some */
#define COUNTED_TO_ZERO (1u << 16)
#define SYSTICK_TOP 0xFFFFFFu
#define RING 512u

/* Bytes from the interrupt to the loop. Each index is written by one side only. */
static volatile uint8_t ring[RING];
static volatile uint32_t ring_begin, ring_end;

/* 200 MHz of the PLL, with the crystal of 8 MHz, divided by 16. */
static void start_clock(void)
{
    uint32_t rcc = (RCC | BYPASS) & ~USE_DIVIDER;
    RCC = rcc;
    rcc = (rcc & ~(0xFu << 6 | 3u << 4 | 1u | POWER_DOWN)) | 0xEu << 6;
    RCC = rcc;
    rcc = (rcc & ~(0xFu << 23)) | 15u << 23 | USE_DIVIDER;
    RCC = rcc;
    while ((RIS & PLL_LOCKED) == 0u) {
    }
    RCC = rcc & ~BYPASS;
}

static void start_uart(void)
{
    const uint32_t sixty_fourths = (SYSTEM_HZ * 8u / BAUD + 1u) / 2u; /* of the divisor, SYSTEM_HZ / (16 BAUD) */
    GPIOA_AFSEL |= 3u;
    GPIOA_DEN |= 3u;
    UART0_CTL = 0;
    UART0_IBRD = sixty_fourths / 64u;
    UART0_FBRD = sixty_fourths % 64u;
    UART0_LCRH = 3u << 5 | 1u << 4; /* 8 bits, buffers */
    UART0_IM = RECEIVED;
    UART0_CTL = 1u << 9 | 1u << 8 | 1u;
}

/* Wakes the processor every 250 us. */
static void start_timer(void)
{
    TIMER0_CTL = 0;
    TIMER0_CFG = 0;
    TIMER0_TAMR = 2; /* periodic */
    TIMER0_TAILR = SYSTEM_HZ / 4000u - 1u;
    TIMER0_IMR = 1;
    TIMER0_CTL = 1;
}

void hardware_init(void)
{
    start_clock();
    RCGC1 |= 1u << 16 | 1u;
    RCGC2 |= 1u;
    (void)RCGC2; /* the units are ready some cycles later */
    SYST_RVR = SYSTICK_TOP;
    SYST_CVR = 0;
    SYST_CSR = 5; /* system clock, without an interrupt */
    start_uart();
    start_timer();
    NVIC_ISER0 = 1u << UART0_INTERRUPT | 1u << TIMER0A_INTERRUPT;
}

uint64_t hardware_now(void)
{
    static uint64_t begin; /* of the current run of SysTick from its top to zero */
    uint32_t left = SYST_CVR;
    if ((SYST_CSR & COUNTED_TO_ZERO) != 0u) { /* reading clears it */
        begin += SYSTICK_TOP + 1u;
        left = SYST_CVR;
    }
    return begin + (SYSTICK_TOP - left);
}

bool hardware_receive(uint8_t *byte)
{
    uint32_t begin = ring_begin;
    if (begin == ring_end) {
        return false;
    }
    *byte = ring[begin];
    ring_begin = (begin + 1u) % RING;
    return true;
}

bool hardware_send(uint8_t byte)
{
    if ((UART0_FR & TRANSMITTER_FULL) != 0u) {
        return false;
    }
    UART0_DR = byte;
    return true;
}

void hardware_sleep(void)
{
    __asm__ volatile("wfi");
}

void uart_interrupt(void)
{
    UART0_ICR = RECEIVED;
    while ((UART0_FR & RECEIVER_EMPTY) == 0u) {
        uint8_t byte = (uint8_t)UART0_DR;
        uint32_t next = (ring_end + 1u) % RING;
        if (next != ring_begin) { /* otherwise the frame is damaged, and the host is told so */
            ring[ring_end] = byte;
            ring_end = next;
        }
    }
}

void timer_interrupt(void)
{
    TIMER0_ICR = 1;
}
