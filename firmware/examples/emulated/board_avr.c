/* An ATmega in simavr: the first serial port at full speed, timer 1 as a counter of cycles. */
#include "board.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

#define STACK_PATTERN 0xA5

extern uint8_t __bss_end;

static volatile uint16_t rounds;

ISR(TIMER1_OVF_vect) { rounds++; }

void board_print(const char *text) {
  for (; *text; text++) {
    while (!(UCSR0A & 1 << UDRE0)) {
    }
    UDR0 = (uint8_t)*text;
  }
}

uint32_t board_ticks(void) {
  uint16_t high, low;
  uint8_t sreg = SREG;
  cli();
  low = TCNT1;
  high = rounds;
  if (TIFR1 & 1 << TOV1 && low < 0x8000) high++;
  SREG = sreg;
  return (uint32_t)high << 16 | low;
}

uint32_t board_between(uint32_t start, uint32_t end) { return end - start; }

void board_start(void) {
  uint8_t *p;
  UBRR0 = 0;
  UCSR0A = 1 << U2X0;
  UCSR0B = 1 << TXEN0;
  TCCR1B = 1; /* as fast as the core */
  TIMSK1 = 1 << TOIE1;
  for (p = &__bss_end; p < (uint8_t *)SP; p++) *p = STACK_PATTERN;
  sei();
}

uint32_t board_unused_stack(void) {
  const uint8_t *p = &__bss_end;
  while (*p == STACK_PATTERN) p++;
  return (uint32_t)(p - &__bss_end);
}

/* simavr ends where a core sleeps with its interrupts off. */
void board_stop(void) {
  while (!(UCSR0A & 1 << UDRE0)) {
  }
  cli();
  sleep_enable();
  sleep_cpu();
}
