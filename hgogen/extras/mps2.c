/* A board in QEMU: reset, FPU on, semihosting for output and exit, SysTick to count, the depth of the stack. */
#include "mps2.h"

extern unsigned _stack_top;

void reset_handler(void);

__attribute__((section(".vectors"), used)) static void *const vectors[2] = {&_stack_top, (void *)reset_handler};

static int semihosting(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void say(const char *text)
{
    (void)semihosting(0x04, text);
}

void say_number(const char *text, unsigned value)
{
    char digits[12];
    char *p = &digits[11];
    *p = '\0';
    *--p = '\n';
    do {
        *--p = (char)('0' + value % 10u);
        value /= 10u;
    } while (value != 0u);
    say(text);
    say(p);
}

/* under `-icount shift=0` an instruction takes 1 ns and a tick of the 25 MHz clock 40 of them */
unsigned ticks(void)
{
    return 0xffffffu - *(volatile unsigned *)0xE000E018;
}

#define PAINTED 65536u

__attribute__((noinline)) void paint(void)
{
    volatile unsigned char *top = __builtin_frame_address(0); /* r7, the lowest byte of this frame */
    for (unsigned i = 1u; i < PAINTED; ++i) {
        top[-(int)i] = 0xA5u;
    }
}

__attribute__((noinline)) unsigned painted_over(void)
{
    const volatile unsigned char *top = __builtin_frame_address(0);
    unsigned depth = PAINTED - 1u;
    while (depth > 0u && top[-(int)depth] == 0xA5u) {
        --depth;
    }
    return depth;
}

void reset_handler(void)
{
    *(volatile unsigned *)0xE000ED88 |= 0xFu << 20; /* CPACR: the FPU before any float */
    __asm__ volatile("dsb\n isb");
    *(volatile unsigned *)0xE000E014 = 0xffffffu; /* SysTick: reload, start from 0, processor clock */
    *(volatile unsigned *)0xE000E018 = 0u;
    *(volatile unsigned *)0xE000E010 = 5u;
    const int code = board_main();
    (void)semihosting(0x18, (const void *)(code == 0 ? 0x20026 : 0x20024));
    for (;;) {
    }
}
