/* The runtime as a shared library, for tests that play with it from Python. */
#define SS_TRIM
#include "softsensor.h"

static ss_sensor sensor;

int bridge_open(const void *network, uint32_t network_bytes, const void *unit, uint32_t unit_bytes, const char *serial) {
  return (int)ss_open(&sensor, network, network_bytes, unit, unit_bytes, serial);
}

void bridge_push(uint16_t code, uint32_t t_ms) { ss_push(&sensor, code, t_ms); }

void bridge_read(uint32_t now_ms, int32_t *out) {
  ss_estimate e = ss_read(&sensor, now_ms);
  out[0] = e.value, out[1] = e.lower, out[2] = e.upper, out[3] = e.flags;
}

int bridge_exponent(void) { return ss_exponent(&sensor); }

int bridge_open_best(const void *a, const void *b, const void *factory, uint32_t bytes, const void *network,
                     uint32_t network_bytes, const char *serial) {
  const void *slots[3] = {a, b, factory};
  return ss_open_best(&sensor, slots, bytes, network, network_bytes, serial);
}

int bridge_slot_to_write(int in_use) { return ss_slot_to_write(in_use); }

static ss_trim trim;

void bridge_trim_start(void) { ss_trim_start(&trim); }
void bridge_trim_sample(int load, uint16_t code) { ss_trim_sample(&trim, &sensor, load, code); }
int bridge_trim_finish(int16_t load_0, int16_t load_1, uint16_t error_0, uint16_t error_1) {
  return (int)ss_trim_finish(&trim, &sensor, load_0, load_1, error_0, error_1);
}
void bridge_trim(int32_t *out) {
  const ss_trim_record *t = &sensor.trim;
  out[0] = t->gain, out[1] = t->offset, out[2] = t->load[0], out[3] = t->load[1], out[4] = t->reach[0], out[5] = t->reach[1];
}
void bridge_set_trim(const int32_t *in) {
  ss_trim_record t = {(int16_t)in[0], (int16_t)in[1], {(int16_t)in[2], (int16_t)in[3]}, {(uint16_t)in[4], (uint16_t)in[5]}};
  ss_trim_restore(&sensor, &t);
}
uint32_t bridge_hypot(uint32_t a, uint32_t b) { return ss_hypot(a, b); }
uint32_t bridge_trim_reach(int32_t value) { return ss_trim_reach(&sensor.trim, value); }

/* Calls every function with nothing at all and with a sensor that was never opened: 0 if each says that it has nothing. */
int bridge_nothing(const void *network, uint32_t network_bytes, const void *unit, uint32_t unit_bytes) {
  static ss_sensor closed;
  const void *slots[3] = {0, 0, 0};
  ss_sensor *sensors[2] = {0, &closed};
  ss_trim t;
  int k;
  ss_trim_start(&t), ss_trim_start(0);
  for (k = 0; k < 2; k++) {
    ss_sensor *s = sensors[k];
    ss_push(s, 1, 2), ss_restart(s);
    if (ss_read(s, 2).flags != SS_CLOSED || ss_exponent(s) != 0) return 1;
    ss_trim_sample(&t, s, 0, 1), ss_trim_sample(0, s, 1, 1);
    if (ss_trim_finish(&t, s, 1, 2, 0, 0) != SS_TRIM_MORE || ss_trim_finish(0, s, 1, 2, 0, 0) != SS_TRIM_MORE) return 3;
    if (ss_open_best(s, slots, 256, network, network_bytes, 0) != -1) return 4;
    if (ss_open_best(s, 0, 256, network, network_bytes, 0) != -1) return 5;
    if (ss_open(s, network, network_bytes, 0, unit_bytes, 0) == SS_OK) return 6;
    if (ss_open(s, 0, network_bytes, unit, unit_bytes, 0) == SS_OK) return 7;
  }
  slots[2] = unit;
  if (ss_open(0, network, network_bytes, unit, unit_bytes, 0) != SS_NO_SENSOR) return 8;
  if (ss_open_best(0, slots, 256, network, network_bytes, 0) != -1) return 9;
  return ss_open_best(&closed, slots, 256, 0, 0, 0) == -1 ? 0 : 10;
}
