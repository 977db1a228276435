/* A Cortex-M in QEMU: semihosting in place of a serial port, SysTick as the counter. */
#include "board.h"

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010u)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018u)
#define STACK_PATTERN 0xA5A5A5A5u

extern uint32_t stack_low[], stack_top[];
extern uint32_t data_load[], data_start[], data_end[], bss_start[], bss_end[];
int main(void);

static uint32_t semihost(uint32_t operation, const void *argument) {
  register uint32_t r0 __asm__("r0") = operation;
  register const void *r1 __asm__("r1") = argument;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
  return r0;
}

void board_print(const char *text) { semihost(4, text); } /* SYS_WRITE0 */

uint32_t board_ticks(void) { return SYSTICK_VALUE; }

/* It counts down through 24 bits. */
uint32_t board_between(uint32_t start, uint32_t end) { return (start - end) & 0xFFFFFFu; }

void board_start(void) {
  uint32_t *p = stack_low, *here;
  SYSTICK_RELOAD = 0xFFFFFF, SYSTICK_VALUE = 0, SYSTICK_CONTROL = 5;
  __asm__ volatile("mov %0, sp" : "=r"(here));
  while (p < here) *p++ = STACK_PATTERN;
}

uint32_t board_unused_stack(void) {
  const uint32_t *p = stack_low;
  while (*p == STACK_PATTERN) p++;
  return (uint32_t)((uintptr_t)p - (uintptr_t)stack_low);
}

void board_stop(void) {
  semihost(0x18, (const void *)0x20026); /* SYS_EXIT, application exit */
  for (;;) {
  }
}

void reset(void) {
  uint32_t *from = data_load, *to = data_start;
  while (to < data_end) *to++ = *from++;
  for (to = bss_start; to < bss_end;) *to++ = 0;
  main();
}

__attribute__((section(".vectors"), used)) static void *const vectors[] = {stack_top, (void *)reset};
