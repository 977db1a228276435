/* softsensor.h - estimates from a soft sensor, calibrated by softcal. C99, header only.
 *
 * Reads `network-<id>.ssc` and `unit-<serial>.ssc` in place (docs/format.md): no allocation, no libc, integers only.
 * The same integers come out on every machine; the files carry test windows that prove it each time they are opened.
 * Little-endian machines with arithmetic right shift, as all that gcc, clang, armcc and IAR are used for today.
 *
 *   static ss_sensor sensor;
 *   if (ss_open(&sensor, network, network_bytes, unit, unit_bytes, "A1") != SS_OK) ...   no number without a good file
 *   every sample:  ss_push(&sensor, code, millis());
 *                  ss_estimate e = ss_read(&sensor, millis());
 *                  if (!(e.flags & SS_NO_NUMBER)) use(e.value);
 */
#ifndef SOFTSENSOR_H
#define SOFTSENSOR_H

#include <stddef.h>
#include <stdint.h>

#ifndef SS_WIDTH
#define SS_WIDTH 120 /* widest hidden layer, rounded up to a multiple of 4; costs 4 bytes of RAM each */
#endif

#define SS_TAPS 15
#define SS_MAGIC 0x46435353u /* S S C F */
#define SS_MAJOR 1
#define SS_MINOR 1  /* files up to this one end where they say; later ones may append something */
#define SS_SHAPES 6 /* a mix has at most this many */
#define SS_HEADER 48
#define SS_AROUND 52 /* header and CRC */
#define SS_TOO_MUCH 0x40000000u

typedef enum {
  SS_OK = 0,
  SS_BAD_ALIGNMENT = 1, /* a file does not start at a multiple of 4 */
  SS_BAD_MAGIC = 2,     /* no calibration file, or a big-endian machine */
  SS_BAD_VERSION = 3,   /* a format this header does not read */
  SS_BAD_LENGTH = 4,    /* cut off, or the wrong length was given */
  SS_BAD_CRC = 5,       /* damaged */
  SS_BAD_KIND = 6,      /* network and unit file mixed up */
  SS_BAD_NETWORK = 7,   /* the unit was calibrated with another network */
  SS_BAD_SERIAL = 8,    /* the file of another unit */
  SS_BAD_LAYOUT = 9,    /* contradicts itself, or needs a larger SS_WIDTH */
  SS_BAD_SELF_TEST = 10 /* this machine does not compute what the factory computed */
} ss_status;

enum {
  SS_WARM_UP = 1,      /* fewer than 15 samples since the start or a gap: no number */
  SS_CLOSED = 2,       /* no good file: no number */
  SS_STALE = 4,        /* the newest sample is older than 1.5 periods */
  SS_OUT_OF_RANGE = 8, /* a code in the window lies outside what the unit was calibrated with */
  SS_CLAMPED = 16,     /* the estimate was clamped to the range of the calibration */
  SS_NO_NUMBER = SS_WARM_UP | SS_CLOSED
};

/* In counts of 10^exponent reference units (ss_exponent). lower ... upper is the 90 % interval. */
typedef struct {
  int16_t value, lower, upper;
  uint8_t flags;
} ss_estimate;

typedef struct {
  const uint8_t *network, *unit; /* bodies of the two files; no unit while closed */
  const uint8_t *map;            /* knots, then the linear part, in the unit file */
  uint32_t last_ms;
  uint16_t gap_ms, range_bits; /* bit k: the k-th newest sample was out of range */
  uint8_t filled;
  int16_t gain, offset;  /* what ss_adapt has changed: gain in 2^-15, offset in source counts */
  int16_t ring[SS_TAPS]; /* samples as the curve mapped them, or centred codes */
  int16_t even[SS_WIDTH], odd[SS_WIDTH];
} ss_sensor;

/* ---- reading the files ---------------------------------------------------------------------------------------- */

/* Every field lies at a multiple of its size, so plain loads do. The files may be arrays of any type, or flash. */
#if defined(__GNUC__)
typedef uint16_t __attribute__((may_alias)) ss_half_word;
typedef uint32_t __attribute__((may_alias)) ss_full_word;
#else
typedef uint16_t ss_half_word;
typedef uint32_t ss_full_word;
#endif

/* Kept out of line: code size is what a small device is short of. */
#if defined(__GNUC__)
#define SS_SHARED __attribute__((noinline, unused)) static
#else
#define SS_SHARED static
#endif

static inline uint32_t ss_u16(const void *p) { return *(const ss_half_word *)p; }
static inline int32_t ss_i16(const void *p) { return (int16_t) * (const ss_half_word *)p; }
static inline uint32_t ss_u32(const void *p) { return *(const ss_full_word *)p; }

/* Word by word and bit by bit: a table would be three times as fast and take 64 bytes; a file is checked once. */
static uint32_t ss_crc32(const uint8_t *p, const uint8_t *end) {
  uint32_t crc = 0xffffffffu, k;
  for (; p != end; p += 4) {
    crc ^= ss_u32(p);
    for (k = 32; k; k--) {
      uint32_t is_odd = crc << 31;
      crc >>= 1;
      if (is_odd) crc ^= 0xedb88320u;
    }
  }
  return ~crc;
}

static int ss_differ(const uint8_t *a, const uint8_t *b, uint32_t n) {
  while (n--)
    if (*a++ != *b++) return 1;
  return 0;
}

/* Header and CRC of one file. */
static ss_status ss_check(const void *file, uint32_t bytes, uint8_t kind) {
  const uint8_t *p = (const uint8_t *)file;
  if (!p || (uintptr_t)p & 3) return SS_BAD_ALIGNMENT;
  if (bytes < SS_AROUND) return SS_BAD_LENGTH;
  if (ss_u32(p) != SS_MAGIC) return SS_BAD_MAGIC;
  if (p[5] != SS_MAJOR) return SS_BAD_VERSION;
  if (ss_u32(p + 8) != bytes || bytes & 3) return SS_BAD_LENGTH;
  if (ss_crc32(p, p + bytes - 4) != ss_u32(p + bytes - 4)) return SS_BAD_CRC;
  return p[4] == kind ? SS_OK : SS_BAD_KIND;
}

/* The functions below get a body: a file without its header. `left` is what of it is not yet accounted for. */
#define SS_IS_LATER(body) (*((body) - SS_HEADER + 6) > SS_MINOR)

/* The bytes of one layer in a file; more than any file has where it is too wide. */
static uint32_t ss_layer_bytes(uint32_t rows, uint32_t columns) {
  return rows - 1 < SS_WIDTH && columns - 1 < SS_WIDTH ? ((rows + 3) & ~3u) * (8 + 2 * columns) : SS_TOO_MUCH;
}

SS_SHARED ss_status ss_check_network(const uint8_t *p, uint32_t left) {
  const uint8_t *sizes = p + 4;
  uint32_t count;
  if (left < 84) return SS_BAD_LAYOUT;
  left -= 84;
  if (p[1] != 1 || ss_u16(sizes) != SS_TAPS) return SS_BAD_LAYOUT;
  for (count = p[0]; count; count--, sizes += 2) { /* a layer takes 40 bytes or more: `left` ends a forged count */
    uint32_t used = ss_layer_bytes(ss_u16(sizes + 2), ss_u16(sizes));
    if (used > left) return SS_BAD_LAYOUT;
    left -= used;
  }
  return ss_u16(sizes) == 1 && (!left || SS_IS_LATER(p)) ? SS_OK : SS_BAD_LAYOUT;
}

static const uint8_t *ss_tests(const uint8_t *unit) { return unit + 28 + 6u * unit[2]; }
static uint32_t ss_map_at(const uint8_t *unit) { return 28u + ((6u * unit[2] + 6u * unit[3] + 3u) & ~3u); }

/* The map of a unit is a curve on every sample (bit 0), and on every window a linear layer (bit 1, format 1.0) or a mix
 * of shapes (bit 2). */
SS_SHARED ss_status ss_check_unit(const uint8_t *p, uint32_t left) {
  uint32_t form = p[0], knots = p[1], used = ss_map_at(p) + 4 * knots, shapes;
  if (form - 1 > 4 || (form & 1) > knots || !p[2] || !p[3] || used > left) return SS_BAD_LAYOUT;
  left -= used, shapes = p[used + 1];
  if (form & 4) left -= shapes - 1 < SS_SHAPES ? (4 + 18 * shapes) & ~3u : SS_TOO_MUCH;
  if (form & 2) left -= ss_layer_bytes(SS_TAPS, SS_TAPS);
  return !left || ((int32_t)left > 0 && SS_IS_LATER(p)) ? SS_OK : SS_BAD_LAYOUT;
}

/* ---- arithmetic: the same integers as softcal.core.export.integer_network --------------------------------------- */

SS_SHARED int32_t ss_clip(int32_t x) { return x > 32767 ? 32767 : x < -32767 ? -32767 : x; }

/* Four rows at once: each activation is loaded once, two words bring four weights; `end` is one past the last
 * activation. Returns the weights that follow. */
#if defined(__GNUC__) && defined(__ARM_ARCH_6M__) && !defined(SS_PORTABLE)
/* The Cortex-M0 has eight easy registers, too few for a compiler to keep this loop out of memory, most of all at -Os. */
__attribute__((naked, noinline, unused)) static const ss_full_word *ss_dot(
    const ss_full_word *w __attribute__((unused)), const int16_t *end __attribute__((unused)),
    uint32_t columns __attribute__((unused)), uint32_t *acc __attribute__((unused))) {
  __asm__ volatile(
      ".syntax unified\n\t"
      "push {r3, r4, r5, r6, r7, lr}\n\t"
      "mov r4, r8\n\t"
      "push {r4}\n\t"
      "lsls r2, r2, #1\n\t"
      "rsbs r2, r2, #0\n\t" /* r2: from -2 columns up to 0 */
      "movs r7, #0\n\t"     /* sums in r12, lr, r8, r7 */
      "mov r12, r7\n\t"
      "mov lr, r7\n\t"
      "mov r8, r7\n"
      "1:\n\t"
      "ldrsh r4, [r1, r2]\n\t"
      "ldmia r0!, {r5, r6}\n\t"
      "sxth r3, r5\n\t"
      "asrs r5, r5, #16\n\t"
      "muls r3, r4, r3\n\t"
      "muls r5, r4, r5\n\t"
      "add r12, r3\n\t"
      "add lr, r5\n\t"
      "sxth r3, r6\n\t"
      "asrs r6, r6, #16\n\t"
      "muls r3, r4, r3\n\t"
      "muls r6, r4, r6\n\t"
      "add r8, r3\n\t"
      "adds r7, r7, r6\n\t"
      "adds r2, r2, #2\n\t"
      "bne 1b\n\t"
      "pop {r1}\n\t"
      "pop {r3}\n\t"
      "mov r4, r12\n\t"
      "mov r5, lr\n\t"
      "mov r6, r8\n\t"
      "stmia r3!, {r4, r5, r6, r7}\n\t"
      "mov r8, r1\n\t"
      "pop {r4, r5, r6, r7, pc}");
}
#else
static const ss_full_word *ss_dot(const ss_full_word *w, const int16_t *end, uint32_t columns, uint32_t *acc) {
  const int16_t *x = end - columns;
  uint32_t a = 0, b = 0, c = 0, d = 0;
  do {
    int32_t v = *x++;
    uint32_t ab = *w++, cd = *w++;
    a += (uint32_t)(v * (int16_t)ab);
    b += (uint32_t)(v * ((int32_t)ab >> 16));
    c += (uint32_t)(v * (int16_t)cd);
    d += (uint32_t)(v * ((int32_t)cd >> 16));
  } while (x != end);
  acc[0] = a, acc[1] = b, acc[2] = c, acc[3] = d;
  return w;
}
#endif

/* The exporter has proved that no accumulator overflows. Sums and products are unsigned and shifts masked all the same,
 * so that even a forged file meets no undefined behaviour; its self-tests then fail. */
SS_SHARED const uint8_t *ss_layer(const uint8_t *record, uint32_t rows, uint32_t columns, const int16_t *in, int16_t *out,
                                  uint32_t is_rectified) {
  const ss_full_word *w;
  const uint8_t *end = record + ((rows + 3) & ~3u) * 8;
  uint32_t acc[4];
  w = (const ss_full_word *)(const void *)end;
  while (record != end) {
    const uint32_t *sum = acc;
    w = ss_dot(w, in + columns, columns, acc);
    do {
      int32_t y = (int32_t)(*sum++ + ss_u32(record));
      uint32_t product;
      if (y < 0 && is_rectified) y = 0;
      product = (uint32_t)(y >> (record[6] & 31)) * ss_u16(record + 4) + (1u << ((record[7] - 1) & 31));
      *out++ = (int16_t)ss_clip((int32_t)product >> (record[7] & 31));
      record += 8;
    } while (sum != acc + 4);
  }
  return (const uint8_t *)w;
}

/* One code on its way into the ring: through the curve, or centred where there is none. */
static int32_t ss_map_code(const ss_sensor *s, uint32_t code) {
  const uint8_t *knot = s->map, *last = knot + 4u * (s->unit[1] - 1u);
  uint32_t x0, span, rise;
  int32_t y0, y1;
  if (!(s->unit[0] & 1)) return ss_clip((int32_t)code - 32768);
  if (code <= ss_u16(knot)) return ss_i16(knot + 2);
  if (code >= ss_u16(last)) return ss_i16(last + 2);
  while (ss_u16(knot + 4) <= code) knot += 4;
  x0 = ss_u16(knot), span = ss_u16(knot + 4) - x0, y0 = ss_i16(knot + 2), y1 = ss_i16(knot + 6);
  rise = (uint32_t)(y1 < y0 ? y0 - y1 : y1 - y0);
  rise = (rise * (code - x0) + span / 2) / span;
  return y1 < y0 ? y0 - (int32_t)rise : y0 + (int32_t)rise;
}

/* A mix of shapes: x = keep x + sum of U_k(tap) w_k, with w_k = row_k . x + bias_k, in 1/64 count. U_k are the Chebyshev
 * polynomials of the second kind at (tap - 7) / 8, summed by Clenshaw's recurrence. Unsigned as above. */
SS_SHARED void ss_mix(const uint8_t *m, int16_t *x) {
  uint32_t w[SS_SHAPES], *end = w;
  const uint8_t *row = m + 2;
  int32_t i;
  do {
    int32_t sum = 0;
    for (i = 0; i < SS_TAPS; i++) sum += (int8_t)*row++ * x[i];
    *end++ = (uint32_t)(sum >> (*row & 31)) + 64u * (uint32_t)ss_i16(row + 1);
    row += 3;
  } while (end != w + m[1]);
  for (i = -7; i < 8; i++, x++) {
    uint32_t total = 0, before = 0, next, *p = end;
    do {
      next = *--p + (uint32_t)((int32_t)((uint32_t)i * total) >> 2) - before;
      before = total, total = next;
    } while (p != w);
    *x = (int16_t)ss_clip((int32_t)(total + (uint32_t)(m[0] * *x) + 32u) >> 6);
  }
}

/* The estimate of the window in s->even. */
SS_SHARED int32_t ss_window(ss_sensor *s) {
  const uint8_t *sizes = s->network + 4, *p = s->network + 84, *map = s->map + 4u * s->unit[1];
  int16_t *in = s->even, *out = s->odd, *done;
  uint32_t left = s->network[0];
  if (s->unit[0] & 4) ss_mix(map, in);
  if (s->unit[0] & 2) {
    ss_layer(map, SS_TAPS, SS_TAPS, in, out, 0);
    done = out, out = in, in = done;
  }
  for (; left; left--, sizes += 2) {
    p = ss_layer(p, ss_u16(sizes + 2), ss_u16(sizes), in, out, left - 1);
    done = out, out = in, in = done;
  }
  return in[0];
}

/* ---- use ------------------------------------------------------------------------------------------------------ */

/* Open both files in place; they must stay where they are. `serial` (20 bytes, filled up with zeros, as in the file)
 * may be 0 where the firmware does not know its own. Anything but SS_OK leaves the sensor closed. */
static ss_status ss_open(ss_sensor *s, const void *network, uint32_t network_bytes, const void *unit,
                         uint32_t unit_bytes, const char *serial) {
  const uint8_t *net = (const uint8_t *)network, *own = (const uint8_t *)unit, *test;
  ss_status status;
  uint32_t i, left;
  s->unit = 0;
  if ((status = ss_check(net, network_bytes, 1)) != SS_OK) return status;
  if ((status = ss_check(own, unit_bytes, 2)) != SS_OK) return status;
  if (ss_differ(net + 12, own + 12, 8)) return SS_BAD_NETWORK;
  if (serial && ss_differ(own + 28, (const uint8_t *)serial, 20)) return SS_BAD_SERIAL;
  net += SS_HEADER, own += SS_HEADER;
  if ((status = ss_check_network(net, network_bytes - SS_AROUND)) != SS_OK) return status;
  if ((status = ss_check_unit(own, unit_bytes - SS_AROUND)) != SS_OK) return status;
  s->network = net, s->unit = own, s->map = own + ss_map_at(own);
  s->gain = s->offset = 0;
  test = ss_tests(own);
  for (left = own[3]; left; left--, test += 6) {
    uint32_t code = ss_u16(test);
    for (i = 0; i < SS_TAPS; i++, code += (uint32_t)ss_i16(test + 2)) s->even[i] = (int16_t)ss_map_code(s, code);
    if (ss_window(s) != ss_i16(test + 4)) {
      s->unit = 0;
      return SS_BAD_SELF_TEST;
    }
  }
  s->gap_ms = (uint16_t)ss_u16(net + 20);
  s->range_bits = 0, s->filled = 0, s->last_ms = 0;
  return SS_OK;
}

/* Take one sample: a 16-bit code, and when it was taken. A step over 1.5 periods empties the window. */
static void ss_push(ss_sensor *s, uint16_t code, uint32_t t_ms) {
  const uint8_t *u = s->unit;
  int32_t y, i;
  if (!u) return;
  if (t_ms - s->last_ms > s->gap_ms) s->filled = 0;
  s->last_ms = t_ms;
  y = ss_map_code(s, code);
  y += s->offset + (s->gain * (y - ss_i16(u + 20)) >> 15);
  for (i = 0; i < SS_TAPS - 1; i++) s->ring[i] = s->ring[i + 1];
  s->ring[i] = (int16_t)ss_clip(y);
  if (s->filled < SS_TAPS) s->filled++;
  s->range_bits = (uint16_t)(s->range_bits << 1 | (code < ss_u16(u + 4) || code > ss_u16(u + 6)));
}

/* The estimate at the newest sample. Where flags & SS_NO_NUMBER there is none: value, lower and upper are 0. */
static ss_estimate ss_read(ss_sensor *s, uint32_t now_ms) {
  ss_estimate e = {0, 0, 0, 0};
  const uint8_t *u = s->unit, *band;
  int32_t value, low, high;
  uint32_t i;
  if (!u) e.flags = SS_CLOSED;
  else if (s->filled < SS_TAPS) e.flags = SS_WARM_UP;
  if (e.flags) return e;
  if (now_ms - s->last_ms > s->gap_ms) e.flags |= SS_STALE;
  if (s->range_bits & 0x7fffu) e.flags |= SS_OUT_OF_RANGE;
  for (i = 0; i < SS_TAPS; i++) s->even[i] = s->ring[i];
  value = ss_window(s), low = ss_i16(u + 8), high = ss_i16(u + 10);
  if (value < low || value > high) e.flags |= SS_CLAMPED, value = value < low ? low : high;
  for (band = u + 28, i = u[2]; i > 1 && value > ss_i16(band); i--) band += 6;
  e.value = (int16_t)value;
  low = value - (int32_t)ss_u16(band + 2), high = value + (int32_t)ss_u16(band + 4);
  e.lower = (int16_t)ss_clip(low);
  e.upper = (int16_t)ss_clip(high);
  return e;
}

/* Power of ten of one count in reference units, for example -3: an estimate of 1234 means 1.234 N. */
static inline int ss_exponent(const ss_sensor *s) { return s->unit ? (int8_t)s->network[3] : 0; }

/* ---- slots: two that updates may write, and one the factory wrote ---------------------------------------------- */

/* Which of the slots 0, 1 (updates) and 2 (factory) to open, or -1: the highest revision among the good updates, else
 * the factory's. `serial` as in ss_open. Give each slot's room in `bytes`; a file says itself how long it is. */
static inline int ss_choose_slot(const void *const slots[3], uint32_t bytes, const void *network, const char *serial) {
  int chosen = -1, i;
  for (i = 2; i >= 0; i--) {
    const uint8_t *p = (const uint8_t *)slots[i];
    uint32_t length;
    if (!p || (uintptr_t)p & 3 || bytes < SS_AROUND || (length = ss_u32(p + 8)) > bytes) continue;
    if (ss_check(p, length, 2) != SS_OK || ss_check_unit(p + SS_HEADER, length - SS_AROUND) != SS_OK) continue;
    if (ss_differ((const uint8_t *)network + 12, p + 12, 8)) continue;
    if (serial && ss_differ(p + 28, (const uint8_t *)serial, 20)) continue;
    if (chosen == 0 || chosen == 1)
      if (ss_u32(p + 20) < ss_u32((const uint8_t *)slots[chosen] + 20)) continue;
    chosen = i;
  }
  return chosen;
}

/* The slot an update may erase and write: never the one in use, never the factory's. Write it whole, then check it with
 * ss_choose_slot: an update that is cut off has a wrong CRC, and the calibration that was in use stays in use. */
static inline int ss_slot_to_write(int in_use) { return in_use == 0 ? 1 : 0; }

/* ---- long use: the device follows slow drift of offset and gain within the bounds of its file ------------------- */

typedef struct {
  int32_t low, high;         /* running quantiles 1/32 and 31/32 of the mapped samples, in 1/64 counts */
  int32_t low_sum, high_sum; /* of the two over this period, in counts */
  uint16_t seen;
} ss_adaptation;

typedef enum {
  SS_WATCHING = 0,        /* not enough samples yet */
  SS_ADAPTED = 1,         /* gain and offset follow; the next samples use them */
  SS_AT_BOUND = 2,        /* the drift is larger than the file allows: held at the bound, recalibrate the unit */
  SS_NOT_ADAPTABLE = 3    /* the file allows no change */
} ss_adapt_result;

static inline void ss_adapt_start(ss_adaptation *a, const ss_sensor *s) {
  a->low = ss_i16(s->unit + 20) * 64, a->high = ss_i16(s->unit + 22) * 64;
  a->low_sum = a->high_sum = 0, a->seen = 0;
}

static inline int32_t ss_bounded(int32_t x, int32_t bound, int *is_at_bound) {
  if (x > bound) return *is_at_bound = 1, bound;
  if (x < -bound) return *is_at_bound = 1, -bound;
  return x;
}

/* Call after every ss_push with the same code; after every `period` samples (minutes of use) gain and offset are set
 * anew from the mean of the two running quantiles over the period. Only for use that keeps returning to rest (and, where
 * the file allows a gain, to full presses): the device cannot tell drift from a change of use. */
static inline ss_adapt_result ss_adapt(ss_adaptation *a, ss_sensor *s, uint16_t code, uint16_t period) {
  const uint8_t *u = s->unit;
  int32_t y, low, high, seen_low, seen_high, step, gain = 0, offset;
  int is_at_bound = 0;
  if (!u || !(u[0] & 1) || !(ss_u16(u + 24) | ss_u16(u + 26))) return SS_NOT_ADAPTABLE;
  if (ss_u16(u + 24) > 16384 || ss_u16(u + 26) > 32767) return SS_NOT_ADAPTABLE; /* keeps ss_push within 32 bits */
  low = ss_i16(u + 20), high = ss_i16(u + 22);
  y = ss_map_code(s, code) * 64;
  step = (high - low) / 256 + 1; /* in 1/64 counts: 0.2 % of the span per sample towards an extreme, 1/31 of it back */
  a->low += y < a->low ? -31 * step : step;
  a->high += y > a->high ? 31 * step : -step;
  a->low_sum += ss_clip(a->low / 64), a->high_sum += ss_clip(a->high / 64); /* below 2^15 * 2^16 */
  if (++a->seen < period) return SS_WATCHING;
  seen_low = a->low_sum / a->seen, seen_high = a->high_sum / a->seen;
  a->low_sum = a->high_sum = 0, a->seen = 0;
  if (seen_high <= seen_low) return SS_AT_BOUND; /* the output stands still: nothing to follow */
  if (ss_u16(u + 24))
    gain = ss_bounded(ss_clip(high - low - seen_high + seen_low) * 32768 / (seen_high - seen_low),
                      (int32_t)ss_u16(u + 24), &is_at_bound);
  offset = low - seen_low - (gain * (seen_low - low) >> 15);
  s->gain = (int16_t)gain;
  s->offset = (int16_t)ss_bounded(offset, (int32_t)ss_u16(u + 26), &is_at_bound);
  return is_at_bound ? SS_AT_BOUND : SS_ADAPTED;
}

#endif
