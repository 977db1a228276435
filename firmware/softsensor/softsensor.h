/* softsensor.h - estimates from a soft sensor, calibrated by softcal. C99, header only.
 *
 * Reads `network-<id>.ssc` and `unit-<serial>.ssc` in place (docs/format.md): no allocation, no libc, integers only.
 * The same integers come out on every machine; the files carry test windows that prove it each time they are opened.
 * Little-endian machines with arithmetic right shift, as all that gcc, clang, armcc and IAR are used for today. `int` may
 * have 16 bits. On an AVR the files lie in program memory (PROGMEM), with SS_IN_RAM defined in RAM.
 *
 *   static ss_sensor sensor;
 *   if (ss_open(&sensor, network, network_bytes, unit, unit_bytes, "A1") != SS_OK) ...   no number without a good file
 *   every sample:  ss_push(&sensor, code, millis());
 *                  ss_estimate e = ss_read(&sensor, millis());
 *                  if (!(e.flags & SS_NO_NUMBER)) use(e.value);
 *
 * Every function takes a sensor that is closed, or none at all: then there is no number. A sensor that is not static
 * must be filled with zeros before ss_open.
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
#define SS_MINOR 0  /* files up to this one end where they say; later ones may append something */
#define SS_LEVELS 25      /* levels of the source at the end of a network file */
#define SS_LEVEL_BYTES 56 /* of the least load, the distance of two, the levels, and two zeros */
#define SS_SHAPES 6 /* a mix has at most this many */
#define SS_HEADER 48
#define SS_AROUND 52 /* header and CRC */
#define SS_TOO_MUCH 0x40000000u
#define SS_SERIAL 20 /* characters of a serial in a file */

#ifndef SS_STUCK_MS
#define SS_STUCK_MS 60000u /* a code that stays the same for so long is flagged */
#endif

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
  SS_BAD_SELF_TEST = 10, /* this machine does not compute what the factory computed */
  SS_NO_SENSOR = 11      /* the sensor to open is a null pointer */
} ss_status;

enum {
  SS_WARM_UP = 1,      /* fewer than 15 samples since the start or a gap: no number */
  SS_CLOSED = 2,       /* no good file: no number */
  SS_STALE = 4,        /* the newest sample is older than 1.5 periods */
  SS_OUT_OF_RANGE = 8, /* a code in the window lies outside what the unit was calibrated with */
  SS_CLAMPED = 16,     /* the estimate was clamped to the range of the calibration */
  SS_WRONG_RATE = 32,  /* the window's samples came too fast, too slowly or unevenly: the network sees another sensor */
  SS_STUCK = 64,       /* the code has been the same for SS_STUCK_MS: nothing is felt, or a wire is broken */
  SS_NO_NUMBER = SS_WARM_UP | SS_CLOSED
};

/* In counts of 10^exponent reference units (ss_exponent). lower ... upper is the 90 % interval. */
typedef struct {
  int16_t value, lower, upper;
  uint8_t flags;
} ss_estimate;

#ifdef SS_TRIM
/* What two known loads have shown: the shift of mapped samples, and how well it is known. All zeros: no trim. */
typedef struct {
  int16_t gain, offset;  /* gain in 2^-15, offset in source counts */
  int16_t load[2];       /* the two loads, in counts as estimates are */
  uint16_t reach[2];     /* 90 % half-width of what is not known at each of them, in the same counts */
} ss_trim_record;
#endif

typedef struct {
  const uint8_t *network, *unit; /* bodies of the two files; no unit while closed */
  const uint8_t *map;            /* knots, then the linear part, in the unit file */
  uint32_t last_ms, moved_ms;    /* when the newest sample was taken; when the code last changed */
  uint32_t least_ms, most_ms;    /* from the oldest sample of a window to its newest */
  uint16_t gap_ms, step_ms;      /* longest and shortest time between two samples */
  uint16_t last_code, range_bits; /* bit k: the k-th newest sample was out of range */
  uint8_t filled, is_stuck;
#ifdef SS_TRIM
  ss_trim_record trim; /* what two known loads have shown (ss_trim_finish) */
#endif
  int16_t ring[SS_TAPS];          /* samples as the curve mapped them, or centred codes */
  uint16_t steps[SS_TAPS];        /* ms from the sample before */
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
#define SS_SHARED static inline
#endif

#if defined(__AVR__) && !defined(SS_IN_RAM)
#include <avr/pgmspace.h>
static inline uint8_t ss_u8(const void *p) { return pgm_read_byte(p); }
static inline uint32_t ss_u16(const void *p) { return pgm_read_word(p); }
static inline int32_t ss_i16(const void *p) { return (int16_t)pgm_read_word(p); }
static inline uint32_t ss_u32(const void *p) { return pgm_read_dword(p); }
#else
static inline uint8_t ss_u8(const void *p) { return *(const uint8_t *)p; }
static inline uint32_t ss_u16(const void *p) { return *(const ss_half_word *)p; }
static inline int32_t ss_i16(const void *p) { return (int16_t) * (const ss_half_word *)p; }
static inline uint32_t ss_u32(const void *p) { return *(const ss_full_word *)p; }
#endif

/* A machine that loads bytes alone asks for no alignment. */
#if defined(__AVR__)
#define SS_IS_ODD(p) 0
#else
#define SS_IS_ODD(p) ((uintptr_t)(p) & 3)
#endif

/* Word by word and bit by bit: a table would be three times as fast and take 64 bytes; a file is checked once. */
static inline uint32_t ss_crc32(const uint8_t *p, const uint8_t *end) {
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

/* Whether two files have the same network id. */
static inline int ss_same_network(const uint8_t *a, const uint8_t *b) {
  return ss_u32(a + 12) == ss_u32(b + 12) && ss_u32(a + 16) == ss_u32(b + 16);
}

/* Whether a unit file is that of another unit than `serial`, a C string of which at most 20 characters are read. */
static inline int ss_is_other(const uint8_t *file, const char *serial) {
  uint8_t i, c = 1;
  for (i = 0; i < SS_SERIAL && c; i++) {
    c = (uint8_t)serial[i];
    if (ss_u8(file + 28 + i) != c) return 1;
  }
  return 0;
}

/* Header and CRC of one file. */
SS_SHARED ss_status ss_check(const void *file, uint32_t bytes, uint8_t kind) {
  const uint8_t *p = (const uint8_t *)file;
  if (!p || SS_IS_ODD(p)) return SS_BAD_ALIGNMENT;
  if (bytes < SS_AROUND) return SS_BAD_LENGTH;
  if (ss_u32(p) != SS_MAGIC) return SS_BAD_MAGIC;
  if (ss_u8(p + 5) != SS_MAJOR) return SS_BAD_VERSION;
  if (ss_u32(p + 8) != bytes || bytes & 3) return SS_BAD_LENGTH;
  if (ss_crc32(p, p + bytes - 4) != ss_u32(p + bytes - 4)) return SS_BAD_CRC;
  return ss_u8(p + 4) == kind ? SS_OK : SS_BAD_KIND;
}

/* The functions below get a body: a file without its header. `left` is what of it is not yet accounted for. */
#define SS_IS_LATER(body) (ss_u8((body) - SS_HEADER + 6) > SS_MINOR)

/* Rows stand in blocks of four. */
#define SS_PADDED(rows) (((uint32_t)(rows) + 3u) & 0xfffffffcu)

/* The bytes of one layer in a file; more than any file has where it is too wide. */
static inline uint32_t ss_layer_bytes(uint32_t rows, uint32_t columns) {
  return rows - 1 < SS_WIDTH && columns - 1 < SS_WIDTH ? SS_PADDED(rows) * (8 + 2 * columns) : SS_TOO_MUCH;
}

SS_SHARED ss_status ss_check_network(const uint8_t *p, uint32_t left) {
  const uint8_t *sizes = p + 4;
  uint32_t count;
  if (left < 84) return SS_BAD_LAYOUT;
  left -= 84;
  if (ss_u8(p + 1) != 1 || ss_u16(sizes) != SS_TAPS) return SS_BAD_LAYOUT;
  for (count = ss_u8(p); count; count--, sizes += 2) { /* a layer takes 40 bytes or more: `left` ends a forged count */
    uint32_t used = ss_layer_bytes(ss_u16(sizes + 2), ss_u16(sizes));
    if (used > left) return SS_BAD_LAYOUT;
    left -= used;
  }
  left -= SS_LEVEL_BYTES;
  return ss_u16(sizes) == 1 && (!left || ((int32_t)left > 0 && SS_IS_LATER(p))) ? SS_OK : SS_BAD_LAYOUT;
}

static inline const uint8_t *ss_tests(const uint8_t *unit) { return unit + 24 + 6u * ss_u8(unit + 2); }
static inline uint32_t ss_map_at(const uint8_t *unit) {
  return 24 + SS_PADDED(6u * ss_u8(unit + 2) + 6u * ss_u8(unit + 3));
}

/* The map of a unit is a curve on every sample (bit 0), and on every window a linear layer (bit 1), a mix of shapes
 * (bit 2). */
SS_SHARED ss_status ss_check_unit(const uint8_t *p, uint32_t left) {
  uint32_t form = ss_u8(p), knots = ss_u8(p + 1), used, shapes;
  if (left < 24) return SS_BAD_LAYOUT;
  used = ss_map_at(p) + 4 * knots;
  if (form - 1 > 4 || (form & 1) > knots || !ss_u8(p + 2) || !ss_u8(p + 3) || used > left) return SS_BAD_LAYOUT;
  left -= used;
  shapes = ss_u8(p + used + 1); /* at the end of the file these are bytes of the CRC */
  if (form & 4) left -= shapes - 1 >= SS_SHAPES ? SS_TOO_MUCH : 4 + 36 * shapes;
  if (form & 2) left -= ss_layer_bytes(SS_TAPS, SS_TAPS);
  return !left || ((int32_t)left > 0 && SS_IS_LATER(p)) ? SS_OK : SS_BAD_LAYOUT;
}

/* ---- arithmetic: the same integers as softcal.core.export.integer_network --------------------------------------- */

SS_SHARED int32_t ss_clip(int32_t x) { return x > 32767 ? 32767 : x < -32767 ? -32767 : x; }

/* Four rows at once: each activation is loaded once, two words bring four weights; `end` is one past the last
 * activation. Returns the weights that follow. */
#if defined(__GNUC__) && defined(__ARM_ARCH_6M__) && !defined(SS_PORTABLE)
/* The Cortex-M0 has eight easy registers, too few for a compiler to keep this loop out of memory, most of all at -Os. */
__attribute__((naked, noinline, unused)) static const uint8_t *ss_dot(
    const uint8_t *w __attribute__((unused)), const int16_t *end __attribute__((unused)),
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
#elif defined(__AVR__)
/* Row by row: an eight-bit machine has no registers for four sums, and 32 by 32 bits take it four times 16 by 16. */
SS_SHARED const uint8_t *ss_dot(const uint8_t *w, const int16_t *end, uint32_t columns, uint32_t *acc) {
  uint8_t row;
  for (row = 0; row < 4; row++) {
    const int16_t *x = end - (uint16_t)columns;
    const uint8_t *weight = w + 2 * row;
    int32_t sum = 0;
    do {
      sum = (int32_t)((uint32_t)sum + (uint32_t)((int32_t)*x++ * (int16_t)ss_i16(weight)));
      weight += 8;
    } while (x != end);
    acc[row] = (uint32_t)sum;
  }
  return w + 8 * (uint16_t)columns;
}
#else
SS_SHARED const uint8_t *ss_dot(const uint8_t *weights, const int16_t *end, uint32_t columns, uint32_t *acc) {
  const ss_full_word *w = (const ss_full_word *)(const void *)weights;
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
  return (const uint8_t *)w;
}
#endif

/* The exporter has proved that no accumulator overflows. Sums and products are unsigned and shifts masked all the same,
 * so that even a forged file meets no undefined behaviour; its self-tests then fail. */
SS_SHARED const uint8_t *ss_layer(const uint8_t *record, uint32_t rows, uint32_t columns, const int16_t *in, int16_t *out,
                                  uint32_t is_rectified) {
  const uint8_t *end = record + SS_PADDED(rows) * 8, *w = end;
  uint32_t acc[4];
  while (record != end) {
    const uint32_t *sum = acc;
    w = ss_dot(w, in + columns, columns, acc);
    do {
      int32_t y = (int32_t)(*sum++ + ss_u32(record));
      uint32_t product, scale = ss_u32(record + 4), shift = scale >> 24 & 31;
      if (y < 0 && is_rectified) y = 0;
      product = (uint32_t)(y >> (scale >> 16 & 31)) * (scale & 0xffffu) + ((uint32_t)1 << ((shift - 1) & 31));
      *out++ = (int16_t)ss_clip((int32_t)product >> shift);
      record += 8;
    } while (sum != acc + 4);
  }
  return w;
}

/* One code on its way into the ring: through the curve, or centred where there is none. */
SS_SHARED int32_t ss_map_code(const ss_sensor *s, uint32_t code) {
  const uint8_t *knot = s->map, *last = knot + 4u * ss_u8(s->unit + 1) - 4;
  uint32_t x0, span, rise;
  int32_t y0, y1;
  if (!(ss_u8(s->unit) & 1)) return ss_clip((int32_t)code - 32768);
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
  uint32_t w[SS_SHAPES], *end = w, shapes = ss_u8(m + 1);
  const uint8_t *row = m + 4;
  int32_t i, keep = ss_u8(m);
  do {
    uint32_t sum = 0, bias = ss_u32(row);
    row += 4;
    for (i = 0; i < SS_TAPS; i++, row += 2) sum += (uint32_t)(ss_i16(row) * x[i]);
    *end++ = (uint32_t)((int32_t)sum >> (ss_u8(row) & 31)) + bias;
    row += 2;
  } while (end != w + shapes);
  for (i = -7; i < 8; i++, x++) {
    uint32_t total = 0, before = 0, next, *p = end;
    do {
      next = *--p + (uint32_t)((int32_t)((uint32_t)i * total) >> 2) - before;
      before = total, total = next;
    } while (p != w);
    *x = (int16_t)ss_clip((int32_t)(total + (uint32_t)(keep * *x) + 32u) >> 6);
  }
}

/* Map the window in s->even; returns where it stands then. */
static inline int16_t *ss_map_window(ss_sensor *s) {
  const uint8_t *map = s->map + 4u * ss_u8(s->unit + 1);
  uint32_t form = ss_u8(s->unit);
  if (form & 4) ss_mix(map, s->even);
  if (!(form & 2)) return s->even;
  ss_layer(map, SS_TAPS, SS_TAPS, s->even, s->odd, 0);
  return s->odd;
}

/* The estimate of the window in s->even. */
SS_SHARED int32_t ss_window(ss_sensor *s) {
  const uint8_t *sizes = s->network + 4, *p = s->network + 84;
  int16_t *in = ss_map_window(s), *out = in == s->even ? s->odd : s->even, *done;
  uint32_t left = ss_u8(s->network);
  for (; left; left--, sizes += 2) {
    p = ss_layer(p, ss_u16(sizes + 2), ss_u16(sizes), in, out, left - 1);
    done = out, out = in, in = done;
  }
  return in[0];
}

/* ---- use ------------------------------------------------------------------------------------------------------ */

/* Open both files in place; they must stay where they are. `serial`, a C string, may be 0 where the firmware does not
 * know its own; at most 20 characters are read, so a longer one is given as it stands in the file (SS_UNIT_SERIAL).
 * Anything but SS_OK leaves the sensor closed. */
SS_SHARED ss_status ss_open(ss_sensor *s, const void *network, uint32_t network_bytes, const void *unit,
                            uint32_t unit_bytes, const char *serial) {
  const uint8_t *net = (const uint8_t *)network, *own = (const uint8_t *)unit, *test;
  ss_status status;
  uint32_t i, left, period_us;
  if (!s) return SS_NO_SENSOR;
  s->unit = 0;
  if ((status = ss_check(net, network_bytes, 1)) != SS_OK) return status;
  if ((status = ss_check(own, unit_bytes, 2)) != SS_OK) return status;
  if (!ss_same_network(net, own)) return SS_BAD_NETWORK;
  if (serial && ss_is_other(own, serial)) return SS_BAD_SERIAL;
  net += SS_HEADER, own += SS_HEADER;
  if ((status = ss_check_network(net, network_bytes - SS_AROUND)) != SS_OK) return status;
  if ((status = ss_check_unit(own, unit_bytes - SS_AROUND)) != SS_OK) return status;
  s->network = net, s->unit = own, s->map = own + ss_map_at(own);
#ifdef SS_TRIM
  s->trim.gain = s->trim.offset = s->trim.load[0] = s->trim.load[1] = 0, s->trim.reach[0] = s->trim.reach[1] = 0;
#endif
  test = ss_tests(own);
  for (left = ss_u8(own + 3); left; left--, test += 6) {
    uint32_t code = ss_u16(test);
    for (i = 0; i < SS_TAPS; i++, code += (uint32_t)ss_i16(test + 2)) s->even[i] = (int16_t)ss_map_code(s, code);
    if (ss_window(s) != ss_i16(test + 4)) {
      s->unit = 0;
      return SS_BAD_SELF_TEST;
    }
  }
  period_us = ss_u32(net + 24);
  s->gap_ms = (uint16_t)ss_u16(net + 20);
  s->step_ms = (uint16_t)((period_us - 1) / 2000); /* half a period, less the ms that whole ms may hide */
  s->least_ms = 63 * period_us / 5000;             /* 14 periods less 10 % */
  s->most_ms = 77 * period_us / 5000;
  s->range_bits = 0, s->filled = 0, s->is_stuck = 0, s->last_ms = 0;
  return SS_OK;
}

/* One code through the curve and the trim: a gain about the unit's low level, and an offset; within 32 bits for a gain of
 * at most 2^14. */
static inline int32_t ss_trimmed(const ss_sensor *s, uint32_t code) {
#ifdef SS_TRIM
  int32_t y = ss_map_code(s, code);
  return ss_clip(y + s->trim.offset + (s->trim.gain * (y - ss_i16(s->unit + 20)) >> 15));
#else
  return ss_map_code(s, code);
#endif
}

#ifdef SS_TRIM
/* Whether a code lies beyond the knots of the curve, where it stays constant and shows nothing. */
static inline int ss_is_beyond(const ss_sensor *s, uint32_t code) {
  return (ss_u8(s->unit) & 1) && (code < ss_u16(s->map) || code > ss_u16(s->map + 4u * ss_u8(s->unit + 1) - 4));
}
#endif

/* Whether a sample is out of range; after a trim it is judged where the trim has put it, y. */
static inline int ss_is_outside(const ss_sensor *s, uint32_t code, int32_t y) {
#ifdef SS_TRIM
  if (s->trim.gain | s->trim.offset) {
    int32_t a = ss_map_code(s, ss_u16(s->unit + 4)), b = ss_map_code(s, ss_u16(s->unit + 6));
    return (a < b ? y < a || y > b : y < b || y > a) || ss_is_beyond(s, code);
  }
#endif
  (void)y;
  return code < ss_u16(s->unit + 4) || code > ss_u16(s->unit + 6);
}

/* Take one sample: a 16-bit code, and when it was taken. A step over 1.5 periods empties the window. */
SS_SHARED void ss_push(ss_sensor *s, uint16_t code, uint32_t t_ms) {
  uint32_t step_ms;
  int32_t y;
  uint8_t i;
  if (!s || !s->unit) return;
  step_ms = t_ms - s->last_ms;
  if (step_ms > s->gap_ms) s->filled = 0;
  if (!s->filled || code != s->last_code) s->is_stuck = 0, s->moved_ms = t_ms;
  if (t_ms - s->moved_ms >= SS_STUCK_MS) s->is_stuck = 1;
  for (i = 0; i < SS_TAPS - 1; i++) s->ring[i] = s->ring[i + 1], s->steps[i] = s->steps[i + 1];
  y = ss_trimmed(s, code);
  s->ring[i] = (int16_t)y;
  s->steps[i] = (uint16_t)step_ms;
  s->last_ms = t_ms, s->last_code = code;
  if (s->filled < SS_TAPS) s->filled++;
  i = (uint8_t)ss_is_outside(s, code, y);
  s->range_bits = (uint16_t)((uint32_t)s->range_bits << 1 | i);
}

/* Forget the samples taken so far: for a program that has fallen behind and begins a new row of samples. */
static inline void ss_restart(ss_sensor *s) {
  if (s) s->filled = 0;
}

/* The band of the unit file that an estimate lies in. */
static inline const uint8_t *ss_band(const uint8_t *unit, int32_t value) {
  const uint8_t *band = unit + 24;
  uint32_t left = ss_u8(unit + 2);
  for (; left > 1 && value > ss_i16(band); left--) band += 6;
  return band;
}

#ifdef SS_TRIM
/* The root of a^2 + b^2, rounded up, at most 65535. Bit by bit: no division, nothing beyond 32 bits. */
SS_SHARED uint32_t ss_hypot(uint32_t a, uint32_t b) {
  uint32_t is_large = (a | b) > 0x7fffu, left, root = 0, bit = 0x40000000u;
  if (!b) return a;
  if (is_large) a = (a + 1) >> 1, b = (b + 1) >> 1; /* a, b <= 65535: the squares of the halves fit */
  left = a * a + b * b;
  for (; bit; bit >>= 2) {
    uint32_t next = root + bit;
    root >>= 1;
    if (left >= next) left -= next, root += bit;
  }
  root = (root + (left > 0)) << is_large;
  return root > 65535u ? 65535u : root;
}

/* 90 % half-width of what a trim left open at an estimate: the errors at the two loads are independent and run in a
 * straight line between and beyond them. 0 without a trim. */
static inline uint32_t ss_trim_reach(const ss_trim_record *t, int32_t value) {
  uint32_t part[2], apart, away;
  uint8_t k;
  if (t->load[0] == t->load[1]) return 0;
  apart = (uint32_t)(t->load[1] > t->load[0] ? (int32_t)t->load[1] - t->load[0] : (int32_t)t->load[0] - t->load[1]);
  for (k = 0; k < 2; k++) {
    int32_t other = t->load[1 - k];
    away = (uint32_t)(value > other ? value - other : other - value); /* at most 65534, so the product fits */
    part[k] = (t->reach[k] * away + apart - 1) / apart;
    if (part[k] > 65535u) part[k] = 65535u;
  }
  return ss_hypot(part[0], part[1]);
}
#endif

/* The estimate at the newest sample. Where flags & SS_NO_NUMBER there is none: value, lower and upper are 0. */
SS_SHARED ss_estimate ss_read(ss_sensor *s, uint32_t now_ms) {
  ss_estimate e = {0, 0, 0, 0};
  const uint8_t *u, *band;
  int32_t value, low, high;
  uint32_t span_ms = 0, i, flags = 0;
  if (!s || !s->unit) e.flags = SS_CLOSED;
  else if (s->filled < SS_TAPS) e.flags = SS_WARM_UP;
  if (e.flags) return e;
  u = s->unit;
  if (now_ms - s->last_ms > s->gap_ms) flags |= SS_STALE;
  if (s->range_bits & 0x7fffu) flags |= SS_OUT_OF_RANGE;
  if (s->is_stuck) flags |= SS_STUCK;
  for (i = 0; i < SS_TAPS; i++) {
    s->even[i] = s->ring[i];
    if (!i) continue; /* the step to the oldest sample lies before the window */
    span_ms += s->steps[i];
    if (s->steps[i] < s->step_ms) flags |= SS_WRONG_RATE;
  }
  if (span_ms + 1 < s->least_ms || span_ms > s->most_ms + 1) flags |= SS_WRONG_RATE;
  value = ss_window(s), low = ss_i16(u + 8), high = ss_i16(u + 10);
  if (value < low || value > high) flags |= SS_CLAMPED, value = value < low ? low : high;
  band = ss_band(u, value);
  e.value = (int16_t)value;
  low = (int32_t)ss_u16(band + 2), high = (int32_t)ss_u16(band + 4);
#ifdef SS_TRIM
  i = ss_trim_reach(&s->trim, value);
  low = (int32_t)ss_hypot((uint32_t)low, i), high = (int32_t)ss_hypot((uint32_t)high, i);
#endif
  e.lower = (int16_t)ss_clip(value - low);
  e.upper = (int16_t)ss_clip(value + high);
  e.flags = (uint8_t)flags;
  return e;
}

/* Power of ten of one count in reference units, for example -3: an estimate of 1234 means 1.234 N. */
static inline int ss_exponent(const ss_sensor *s) { return s && s->unit ? (int8_t)ss_u8(s->network + 3) : 0; }

/* ---- slots: two that updates may write, and one the factory wrote ---------------------------------------------- */

/* Open the best of the slots 0, 1 (updates) and 2 (factory): the highest revision that opens, self-tests and all; of
 * equal ones the first. An update older than the factory's file is never taken. Returns the slot in use, or -1 with the
 * sensor closed. Give each slot's room in bytes; a file says itself how long it is. Other arguments as in ss_open. */
static inline int ss_open_best(ss_sensor *s, const void *const slots[3], uint32_t room, const void *network,
                               uint32_t network_bytes, const char *serial) {
  uint32_t length, revision;
  uint32_t best = 0;
  int k, slot, left = 7; /* one bit a slot that was not tried */
  if (s) s->unit = 0;
  if (!s || !slots || room < SS_AROUND) return -1;
  for (k = 0; k < 3; k++)
    if (!slots[k] || SS_IS_ODD(slots[k])) left &= ~(1 << k);
  while (left) { /* what a slot claims says when it is tried; only a file that opens is taken */
    for (k = 0, slot = -1; k < 3; k++) {
      if (!(left >> k & 1)) continue;
      revision = ss_u32((const uint8_t *)slots[k] + 20);
      if (slot < 0 || revision > best) slot = k, best = revision;
    }
    left &= ~(1 << slot);
    length = ss_u32((const uint8_t *)slots[slot] + 8);
    if (length <= room && ss_open(s, network, network_bytes, slots[slot], length, serial) == SS_OK) return slot;
  }
  return -1;
}

/* The slot an update may erase and write, given what ss_open_best returned: never the one in use, never the factory's.
 * Write it whole, then call ss_open_best again: an update that is cut off or does not pass its self-tests is passed
 * over, and the calibration that was in use stays in use. */
static inline int ss_slot_to_write(int in_use) { return in_use == 0 ? 1 : 0; }

/* ---- trim: two known loads bring a unit that has drifted back --------------------------------------------------- */

/* Define SS_TRIM before including this header to have it: a device that is never trimmed needs none of its code. */
#ifdef SS_TRIM

typedef struct {
  int32_t sum[2];
  int16_t least[2], most[2];
  uint16_t count[2];
  uint8_t is_beyond; /* a code lay beyond the knots of the curve */
} ss_trim;

typedef enum {
  SS_TRIMMED = 0,          /* gain and offset are set; the window is empty and fills anew */
  SS_TRIM_MORE = 1,        /* closed, or fewer than 15 samples under one of the loads */
  SS_TRIM_MOVING = 2,      /* the output moved under a load */
  SS_TRIM_OUT_OF_REACH = 3, /* the source was not pressed so, or the curve of the unit does not reach these codes */
  SS_TRIM_TOO_FAR = 4,     /* a gain of more than half, or an offset beyond 16 bits: this is another sensor */
  SS_TRIM_TOO_CLOSE = 5,   /* the two loads are the same number, or are not known to 16383 counts */
  SS_TRIM_ALIKE = 6,       /* the two loads cannot be told apart: they or their outputs differ by less than is known */
  SS_TRIM_NEEDLESS = 7,    /* the unit reads both loads already, as well as a trim would be known */
  SS_TRIM_WORSE = 8        /* the loads would read worse than before */
} ss_trim_result;

static inline void ss_trim_start(ss_trim *t) {
  uint8_t k;
  if (!t) return;
  t->is_beyond = 0;
  for (k = 0; k < 2; k++) t->sum[k] = 0, t->count[k] = 0, t->least[k] = 32767, t->most[k] = -32767;
}

/* Take up a trim again after ss_open, kept in non-volatile memory since ss_trim_finish; the window fills anew. */
static inline void ss_trim_restore(ss_sensor *s, const ss_trim_record *kept) {
  if (!s || !s->unit || !kept) return;
  s->trim = *kept, s->filled = 0;
}

/* Take one sample while load 0 or 1 rests on the sensor; 15 to 4096 of each are used. */
static inline void ss_trim_sample(ss_trim *t, const ss_sensor *s, int load, uint16_t code) {
  int32_t y;
  int k = load != 0;
  if (!t || !s || !s->unit || t->count[k] >= 4096) return;
  y = ss_map_code(s, code);
  if (ss_is_beyond(s, code)) t->is_beyond = 1;
  t->sum[k] += y, t->count[k]++;
  if (y < t->least[k]) t->least[k] = (int16_t)y;
  if (y > t->most[k]) t->most[k] = (int16_t)y;
}

static inline void ss_fill(ss_sensor *s, int32_t y) {
  uint8_t i;
  for (i = 0; i < SS_TAPS; i++) s->even[i] = (int16_t)y;
}

/* How far the estimate of a window in which every mapped sample is y is from a load. */
SS_SHARED uint32_t ss_misread(ss_sensor *s, int32_t y, int32_t load) {
  ss_fill(s, y);
  y = ss_window(s) - load;
  return (uint32_t)(y < 0 ? -y : y);
}

/* The level of such a window in front of the network, times 15. */
static inline int32_t ss_level(ss_sensor *s, int32_t y) {
  const int16_t *x;
  uint8_t i;
  ss_fill(s, y);
  x = ss_map_window(s);
  for (y = 0, i = 0; i < SS_TAPS; i++) y += x[i];
  return y;
}

/* Find the mapped sample that at rest stands where the source stands under a load: a straight line between the levels
 * in the network file, then by bisection. 0 where there is none. */
SS_SHARED int ss_rest_of(ss_sensor *s, int32_t load, int32_t *found) {
  const uint8_t *p = s->network + 84, *sizes = s->network + 4;
  int32_t a = -32767, b = 32767, at_a, at_b, middle, at, rise;
  uint32_t k, away, step;
  for (k = ss_u8(s->network); k; k--, sizes += 2) p += ss_layer_bytes(ss_u16(sizes + 2), ss_u16(sizes));
  step = ss_u16(p + 2);
  if (load < ss_i16(p) || !step) return 0;
  away = (uint32_t)(load - ss_i16(p)), k = away / step, away -= k * step;
  if (k > SS_LEVELS - 1 || (k == SS_LEVELS - 1 && away)) return 0;
  p += 4 + 2 * k, at = ss_i16(p);
  if (away) {
    rise = ss_i16(p + 2) - at;
    middle = (int32_t)(((uint32_t)(rise < 0 ? -rise : rise) * away + step / 2) / step);
    at += rise < 0 ? -middle : middle;
  }
  load = SS_TAPS * at;
  at_a = ss_level(s, a), at_b = ss_level(s, b);
  if (at_a > at_b) middle = a, a = b, b = middle, at = at_a, at_a = at_b, at_b = at;
  if (load < at_a || load > at_b) return 0;
  while (b - a > 1 || a - b > 1) {
    middle = a + (b - a) / 2, at = ss_level(s, middle);
    if (at < load) a = middle, at_a = at;
    else b = middle, at_b = at;
  }
  *found = load - at_a <= at_b - load ? a : b;
  return 1;
}

static inline uint32_t ss_apart(int32_t a, int32_t b) { return (uint32_t)(a < b ? b - a : a - b); }

/* Set gain and offset from what was seen under two known loads (in counts, as estimates are) and empty the window; from
 * then on intervals hold what the trim leaves open. `error_0` and `error_1` are the standard uncertainties of the loads,
 * in the same counts. Keep `trim` of ss_sensor in
 * non-volatile memory, and give it to ss_trim_restore after ss_open, if it shall outlast a restart. Unless SS_TRIMMED
 * nothing changes. `softcal trim` has the same rule. */
static inline ss_trim_result ss_trim_finish(const ss_trim *t, ss_sensor *s, int16_t load_0, int16_t load_1,
                                            uint16_t error_0, uint16_t error_1) {
  int32_t seen[2], wanted[2] = {0, 0}, missing, gain, offset;
  uint32_t reach[2], wrong[2], before[2], apart, rise, loads, is_open, is_needless = 1;
  int k;
  if (!t || !s || !s->unit || t->count[0] < SS_TAPS || t->count[1] < SS_TAPS) return SS_TRIM_MORE;
  if (load_0 == load_1 || error_0 > 16383 || error_1 > 16383) return SS_TRIM_TOO_CLOSE;
  if (t->is_beyond || !ss_rest_of(s, load_0, &wanted[0]) || !ss_rest_of(s, load_1, &wanted[1])) return SS_TRIM_OUT_OF_REACH;
  for (k = 0; k < 2; k++) seen[k] = t->sum[k] / t->count[k];
  apart = ss_apart(seen[0], seen[1]), rise = ss_apart(wanted[0], wanted[1]), loads = ss_apart(load_0, load_1);
  if (!apart || !rise) return SS_TRIM_ALIKE;
  for (k = 0; k < 2; k++)
    if (4 * ss_apart(t->least[k], t->most[k]) > apart) return SS_TRIM_MOVING;
  for (k = 0; k < 2; k++) { /* 90 % half-width of what is not known at one load; 1.645 / sqrt(12), and 1.645, in 1/256 */
    int16_t load = k ? load_1 : load_0;
    const uint8_t *band = ss_band(s->unit, load);
    uint32_t minus = ss_u16(band + 2), plus = ss_u16(band + 4);
    uint32_t spread = ((ss_apart(t->least[k], t->most[k]) + 2) * loads + apart - 1) / apart;
    wrong[k] = ss_misread(s, wanted[k], load), before[k] = ss_misread(s, seen[k], load);
    spread = ss_hypot((122 * spread + 255) / 256, (422 * (uint32_t)(k ? error_1 : error_0) + 255) / 256);
    reach[k] = ss_hypot(ss_hypot(spread, wrong[k]), minus > plus ? minus : plus);
  }
  is_open = ss_hypot(reach[0], reach[1]);
  if (loads <= is_open || apart * loads / rise <= is_open) return SS_TRIM_ALIKE;
  missing = wanted[1] - wanted[0] - (seen[1] - seen[0]);
  if (ss_apart(missing, 0) > apart / 2) return SS_TRIM_TOO_FAR;
  for (k = 0; k < 2; k++) {
    uint32_t off = ss_apart(wanted[k], seen[k]) * loads / rise;
    if (422 * (off > 65535u ? 65535u : off) > 256 * reach[k]) is_needless = 0;
  }
  if (is_needless) return SS_TRIM_NEEDLESS;
  if (ss_hypot(wrong[0], wrong[1]) > ss_hypot(before[0], before[1])) return SS_TRIM_WORSE;
  gain = missing * 32768 / (seen[1] - seen[0]);
  offset = wanted[0] - seen[0] - (gain * (seen[0] - ss_i16(s->unit + 20)) >> 15);
  if (offset > 32767 || offset < -32767) return SS_TRIM_TOO_FAR;
  s->trim.gain = (int16_t)gain, s->trim.offset = (int16_t)offset;
  s->trim.load[0] = load_0, s->trim.load[1] = load_1;
  s->trim.reach[0] = (uint16_t)reach[0], s->trim.reach[1] = (uint16_t)reach[1];
  s->filled = 0;
  return SS_TRIMMED;
}
#endif

#endif
