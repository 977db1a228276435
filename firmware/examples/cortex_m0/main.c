/* Runs a unit's codes through the runtime on a Cortex-M0 and prints every estimate and what it cost.
 *
 * For QEMU's `microbit` machine (see Makefile), with semihosting in place of a serial port. network.h and unit.h come
 * from `softcal export --format c`; codes.h holds `static const uint16_t codes[]`, samples 20 ms apart.
 */
#include "network.h"
#include "unit.h"

#include "softsensor.h"

#include "codes.h"

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010u)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018u)
#define STACK_PATTERN 0xA5A5A5A5u

extern uint32_t stack_low[], stack_top[];

static uint32_t semihost(uint32_t operation, const void *argument) {
  register uint32_t r0 __asm__("r0") = operation;
  register const void *r1 __asm__("r1") = argument;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
  return r0;
}

static void print_text(const char *text) { semihost(4, text); } /* SYS_WRITE0 */

static void print_number(int32_t x, const char *after) {
  char text[12], *p = text + 11;
  uint32_t rest = x < 0 ? 0u - (uint32_t)x : (uint32_t)x;
  *p = 0;
  do *--p = (char)('0' + rest % 10), rest /= 10;
  while (rest);
  if (x < 0) *--p = '-';
  print_text(p);
  print_text(after);
}

static void paint_stack(void) {
  uint32_t *p = stack_low, *here;
  __asm__ volatile("mov %0, sp" : "=r"(here));
  while (p < here) *p++ = STACK_PATTERN;
}

static uint32_t unused_stack(void) {
  const uint32_t *p = stack_low;
  while (*p == STACK_PATTERN) p++;
  return (uint32_t)((uintptr_t)p - (uintptr_t)stack_low);
}

static ss_sensor sensor;

/* Not inlined, so that the stack they need is seen apart from that of main. */
static __attribute__((noinline)) ss_status open_sensor(void) {
  return ss_open(&sensor, SS_NETWORK, SS_NETWORK_BYTES, SS_UNIT, SS_UNIT_BYTES, SS_UNIT_SERIAL);
}

static __attribute__((noinline)) ss_estimate sample(uint16_t code, uint32_t t_ms) {
  ss_push(&sensor, code, t_ms);
  return ss_read(&sensor, t_ms);
}

int main(void) {
  uint32_t i, start, spent, most = 0, before, after;
  ss_status status;
  SYSTICK_RELOAD = 0xFFFFFF, SYSTICK_VALUE = 0, SYSTICK_CONTROL = 5;
  paint_stack();
  before = unused_stack();
  start = SYSTICK_VALUE;
  status = open_sensor();
  spent = (start - SYSTICK_VALUE) & 0xFFFFFF;
  print_text("status "), print_number((int32_t)status, "\n");
  print_text("open_ticks "), print_number((int32_t)spent, "\n");
  for (i = 0; i < sizeof codes / sizeof *codes; i++) {
    ss_estimate e;
    start = SYSTICK_VALUE;
    e = sample(codes[i], 1000 + 20 * i);
    spent = (start - SYSTICK_VALUE) & 0xFFFFFF;
    if (spent > most) most = spent;
    print_text("e "), print_number(e.value, " "), print_number(e.lower, " "), print_number(e.upper, " ");
    print_number(e.flags, "\n");
  }
  after = unused_stack();
  print_text("estimate_ticks "), print_number((int32_t)most, "\n");
  print_text("ram_bytes "), print_number((int32_t)sizeof sensor, "\n");
  print_text("stack_bytes "), print_number((int32_t)(before - after), "\n");
  semihost(0x18, (const void *)0x20026); /* SYS_EXIT, application exit */
  for (;;) {
  }
}

extern uint32_t data_load[], data_start[], data_end[], bss_start[], bss_end[];

void reset(void) {
  uint32_t *from = data_load, *to = data_start;
  while (to < data_end) *to++ = *from++;
  for (to = bss_start; to < bss_end;) *to++ = 0;
  main();
}

__attribute__((section(".vectors"), used)) static void *const vectors[] = {stack_top, (void *)reset};
