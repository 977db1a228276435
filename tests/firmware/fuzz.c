/* Damages a good pair of files in many ways and opens every one: prints how many were tried and accepted.
 *
 *   fuzz network.ssc unit.ssc unit_rounds network_rounds forged_rounds seed
 *
 * Damaged files keep their CRC field: none may be accepted. Forged files get a CRC of their own; they may be refused or
 * not, but whatever they say nothing may be read or written out of bounds (run this under the sanitizers). Each file
 * lies in a heap block of exactly its size.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "softsensor.h"

static uint32_t state;

static uint32_t random_below(uint32_t bound) {
  state ^= state << 13, state ^= state >> 17, state ^= state << 5;
  return state % bound;
}

static uint8_t *read_file(const char *name, uint32_t *bytes) {
  FILE *file = fopen(name, "rb");
  uint8_t *content = malloc(1 << 20);
  if (!file || !content) exit(2);
  *bytes = (uint32_t)fread(content, 1, 1 << 20, file);
  fclose(file);
  return content;
}

static uint8_t *copy(const uint8_t *content, uint32_t bytes) {
  uint8_t *twin = malloc(bytes ? bytes : 1);
  if (!twin) exit(2);
  memcpy(twin, content, bytes);
  return twin;
}

/* Flip bits, overwrite runs, cut or swap pieces; returns the new length. */
static uint32_t damage(uint8_t *p, uint32_t bytes) {
  uint32_t at = random_below(bytes), n = 1 + random_below(8), k;
  switch (random_below(5)) {
    case 0: p[at] ^= (uint8_t)(1u << random_below(8)); break;
    case 1: for (k = 0; k < n; k++) p[(at + k) % bytes] = (uint8_t)random_below(256); break;
    case 2: for (k = 0; k < n; k++) p[random_below(bytes)] ^= (uint8_t)(1 + random_below(255)); break;
    case 3: return at;
    default: for (k = 0; k < n; k++) p[(at + k) % bytes] = k & 1 ? 0xff : 0;
  }
  return bytes;
}

static void reseal(uint8_t *p, uint32_t bytes) {
  uint32_t crc;
  if (bytes < 16 || bytes & 3) return;
  memcpy(p + 8, &bytes, 4);
  crc = ss_crc32(p, p + bytes - 4);
  memcpy(p + bytes - 4, &crc, 4);
}

static ss_sensor sensor;

/* 1 when the pair opens although it differs from the good one. */
static uint32_t try_pair(const uint8_t *network, uint32_t network_bytes, const uint8_t *unit, uint32_t unit_bytes) {
  uint8_t *a = copy(network, network_bytes), *b = copy(unit, unit_bytes);
  ss_status status = ss_open(&sensor, a, network_bytes, b, unit_bytes, 0);
  uint32_t k;
  for (k = 0; k < 20; k++) {
    ss_push(&sensor, (uint16_t)random_below(65536), 20 * k);
    if (status != SS_OK && !(ss_read(&sensor, 20 * k).flags & SS_NO_NUMBER)) exit(3); /* a number without a file */
    if (status == SS_OK) ss_read(&sensor, 20 * k);
  }
  free(a), free(b);
  return status == SS_OK;
}

int main(int count, char **arguments) {
  uint32_t network_bytes, unit_bytes, accepted = 0, opened = 0, tried = 0, k, rounds[3];
  uint8_t *network, *unit;
  if (count < 7) return 64;
  network = read_file(arguments[1], &network_bytes), unit = read_file(arguments[2], &unit_bytes);
  for (k = 0; k < 3; k++) rounds[k] = (uint32_t)strtoul(arguments[3 + k], 0, 10);
  state = (uint32_t)strtoul(arguments[6], 0, 10) | 1;
  if (!try_pair(network, network_bytes, unit, unit_bytes)) return 4;
  for (k = 0; k < rounds[0] + rounds[1]; k++) {
    int is_unit = k < rounds[0];
    const uint8_t *good = is_unit ? unit : network;
    uint32_t bytes = is_unit ? unit_bytes : network_bytes, length;
    uint8_t *bad = copy(good, bytes);
    length = damage(bad, bytes);
    if (length != bytes || memcmp(bad, good, bytes)) {
      tried++;
      accepted += is_unit ? try_pair(network, network_bytes, bad, length) : try_pair(bad, length, unit, unit_bytes);
    }
    free(bad);
  }
  for (k = 0; k < rounds[2]; k++) {
    uint8_t *forged_network = copy(network, network_bytes), *forged_unit = copy(unit, unit_bytes);
    uint32_t a = network_bytes, b = unit_bytes;
    if (k & 1) a = damage(forged_network, k % 3 ? 160 : a) == 160 ? network_bytes : a, reseal(forged_network, a);
    else b = damage(forged_unit, unit_bytes), reseal(forged_unit, b);
    memcpy(forged_unit + 12, forged_network + 12, b > 24 ? 8 : 0);
    reseal(forged_unit, b);
    opened += try_pair(forged_network, a, forged_unit, b);
    free(forged_network), free(forged_unit);
  }
  free(network), free(unit);
  printf("damaged %u accepted %u forged %u opened %u\n", tried, accepted, rounds[2], opened);
  return 0;
}
