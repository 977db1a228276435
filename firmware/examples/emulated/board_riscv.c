/* An RV32 in QEMU (`virt`): semihosting in place of a serial port, retired instructions as the counter. */
#include "board.h"

#define STACK_PATTERN 0xA5A5A5A5u

extern uint32_t stack_low[];

static long semihost(long operation, const void *argument) {
  register long a0 __asm__("a0") = operation;
  register const void *a1 __asm__("a1") = argument;
  /* The three instructions must be these, uncompressed and within one page. */
  __asm__ volatile(
      ".option push\n\t"
      ".option norvc\n\t"
      ".balign 16\n\t"
      "slli zero, zero, 0x1f\n\t"
      "ebreak\n\t"
      "srai zero, zero, 7\n\t"
      ".option pop"
      : "+r"(a0)
      : "r"(a1)
      : "memory");
  return a0;
}

void board_print(const char *text) { semihost(4, text); }

uint32_t board_ticks(void) {
  uint32_t count;
  __asm__ volatile("csrr %0, minstret" : "=r"(count));
  return count;
}

uint32_t board_between(uint32_t start, uint32_t end) { return end - start; }

void board_start(void) {
  uint32_t *p = stack_low, *here;
  __asm__ volatile("mv %0, sp" : "=r"(here));
  while (p < here) *p++ = STACK_PATTERN;
}

uint32_t board_unused_stack(void) {
  const uint32_t *p = stack_low;
  while (*p == STACK_PATTERN) p++;
  return (uint32_t)((uintptr_t)p - (uintptr_t)stack_low);
}

void board_stop(void) {
  static const uint32_t stopped[2] = {0x20026, 0};
  semihost(0x18, (const void *)(uintptr_t)stopped[0]);
  for (;;) {
  }
}

__attribute__((naked, section(".reset"), used)) void reset(void) {
  __asm__ volatile(
      "la sp, stack_top\n\t"
      "la t0, bss_start\n\t"
      "la t1, bss_end\n"
      "1:\n\t"
      "bgeu t0, t1, 2f\n\t"
      "sw zero, 0(t0)\n\t"
      "addi t0, t0, 4\n\t"
      "j 1b\n"
      "2:\n\t"
      "call main\n"
      "3:\n\t"
      "j 3b");
}
