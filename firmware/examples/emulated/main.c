/* Runs a unit's codes through the runtime on an emulated board and prints every estimate and what it cost.
 *
 * `make BOARD=m0 run` (or m4, rv32, uno, mega) with network.h and unit.h from `softcal export --format c`, and codes.h
 * with `static const uint16_t SS_TABLE codes[]`, samples 20 ms apart, in HEADERS. What differs between boards (a line of
 * output, a counter, the end) is in board_*.c.
 */
#include "network.h"
#include "unit.h"

#ifdef TRIM
#define SS_TRIM
#endif
#include "softsensor.h"

#include "codes.h"

#include "board.h"

#define CODES (sizeof codes / sizeof *codes)

static void print_number(int32_t x, const char *after) {
  char text[12], *p = text + 11;
  uint32_t rest = x < 0 ? 0u - (uint32_t)x : (uint32_t)x;
  *p = 0;
  do *--p = (char)('0' + rest % 10), rest /= 10;
  while (rest);
  if (x < 0) *--p = '-';
  board_print(p);
  board_print(after);
}

static void print_named(const char *name, uint32_t x) {
  board_print(name);
  print_number((int32_t)x, "\n");
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

/* -DTRIM=load,load -DTRIM_CODES=code,code -DTRIM_ERRORS=error,error: two known loads, the codes they give, and how well
 * they are known; the estimates go on trimmed. */
#ifdef TRIM
static __attribute__((noinline)) void trim_sensor(void) {
  static const int16_t loads[2] = {TRIM};
  static const uint16_t at_rest[2] = {TRIM_CODES}, errors[2] = {TRIM_ERRORS};
  static ss_trim trim;
  uint8_t k, i;
  ss_trim_start(&trim);
  for (k = 0; k < 2; k++)
    for (i = 0; i < 20; i++) ss_trim_sample(&trim, &sensor, k, at_rest[k]);
  print_named("trim ", (uint32_t)ss_trim_finish(&trim, &sensor, loads[0], loads[1], errors[0], errors[1]));
  print_named("trim_gain ", (uint32_t)(int32_t)sensor.trim.gain);
  print_named("trim_offset ", (uint32_t)(int32_t)sensor.trim.offset);
  print_named("trim_reach_0 ", sensor.trim.reach[0]);
  print_named("trim_reach_1 ", sensor.trim.reach[1]);
}
#endif

int main(void) {
  uint32_t i, start, spent, most = 0, before, after;
  ss_status status;
  board_start();
  before = board_unused_stack();
  start = board_ticks();
  status = open_sensor();
  spent = board_between(start, board_ticks());
  print_named("status ", (uint32_t)status);
  print_named("open_ticks ", spent);
#ifdef TRIM
  trim_sensor();
#endif
  for (i = 0; i < CODES; i++) {
    ss_estimate e;
    uint16_t code = (uint16_t)ss_u16(&codes[i]);
    start = board_ticks();
    e = sample(code, 1000 + 20 * i);
    spent = board_between(start, board_ticks());
    if (spent > most) most = spent;
    board_print("e "), print_number(e.value, " "), print_number(e.lower, " "), print_number(e.upper, " ");
    print_number(e.flags, "\n");
  }
  after = board_unused_stack();
  print_named("estimate_ticks ", most);
  print_named("per_1000_ticks ", PER_1000_TICKS);
  print_named("ram_bytes ", (uint32_t)sizeof sensor);
  print_named("stack_bytes ", before - after);
  board_stop();
  return 0;
}
