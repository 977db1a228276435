/* The runtime as a shared library, for tests that play with it from Python. */
#include "softsensor.h"

static ss_sensor sensor;
static ss_adaptation adaptation;

int bridge_open(const void *network, uint32_t network_bytes, const void *unit, uint32_t unit_bytes, const char *serial) {
  int status = (int)ss_open(&sensor, network, network_bytes, unit, unit_bytes, serial);
  if (status == SS_OK) ss_adapt_start(&adaptation, &sensor);
  return status;
}

void bridge_push(uint16_t code, uint32_t t_ms) { ss_push(&sensor, code, t_ms); }

void bridge_read(uint32_t now_ms, int32_t *out) {
  ss_estimate e = ss_read(&sensor, now_ms);
  out[0] = e.value, out[1] = e.lower, out[2] = e.upper, out[3] = e.flags;
}

int bridge_adapt(uint16_t code, uint16_t period) { return (int)ss_adapt(&adaptation, &sensor, code, period); }
int bridge_gain(void) { return sensor.gain; }
int bridge_offset(void) { return sensor.offset; }
int bridge_exponent(void) { return ss_exponent(&sensor); }

int bridge_choose(const void *a, const void *b, const void *factory, uint32_t bytes, const void *network,
                  const char *serial) {
  const void *slots[3] = {a, b, factory};
  return ss_choose_slot(slots, bytes, network, serial);
}

int bridge_slot_to_write(int in_use) { return ss_slot_to_write(in_use); }
