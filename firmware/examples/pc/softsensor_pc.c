/* Estimates on a PC or any board with files and standard input.
 *
 *   cc -std=c99 -O2 -DSS_WIDTH=512 -I../../softsensor softsensor_pc.c -o softsensor_pc
 *   ./softsensor_pc network-<id>.ssc unit-<serial>.ssc [serial] < codes.txt
 *
 * codes.txt has one sample per line: the time in ms at which it was taken, not at which it is read, and 16-bit code. One line comes out per sample: value, lower, upper in
 * counts of 10^exponent, and the flags. Ends with the runtime's status when a file is refused.
 */
#include <stdio.h>
#include <stdlib.h>

#ifndef SS_WIDTH
#define SS_WIDTH 512 /* a PC has room for any network of softcal's */
#endif
#include "softsensor.h"

static void *read_file(const char *name, uint32_t *bytes) {
  FILE *file = fopen(name, "rb");
  long length = -1;
  void *content;
  if (!file) return 0;
  if (fseek(file, 0, SEEK_END) == 0) length = ftell(file);
  if (length < 0) length = 0;
  rewind(file);
  content = malloc(length ? (size_t)length : 1); /* malloc aligns by more than 4 */
  if (content && fread(content, 1, (size_t)length, file) != (size_t)length) length = 0;
  fclose(file);
  *bytes = (uint32_t)length;
  return content;
}

int main(int count, char **arguments) {
  static ss_sensor sensor;
  uint32_t network_bytes = 0, unit_bytes = 0;
  void *network, *unit;
  unsigned long t_ms, code;
  ss_status status;
  if (count < 3) {
    fprintf(stderr, "use: %s network-<id>.ssc unit-<serial>.ssc [serial] < codes.txt\n", arguments[0]);
    return 64;
  }
  network = read_file(arguments[1], &network_bytes);
  unit = read_file(arguments[2], &unit_bytes);
  if (!network || !unit) {
    fprintf(stderr, "%s cannot be read\n", arguments[network ? 2 : 1]);
    free(network), free(unit);
    return 66;
  }
  status = ss_open(&sensor, network, network_bytes, unit, unit_bytes, count > 3 ? arguments[3] : 0);
  if (status == SS_OK) {
    while (scanf("%lu %lu", &t_ms, &code) == 2) {
      ss_estimate e;
      ss_push(&sensor, (uint16_t)code, (uint32_t)t_ms);
      e = ss_read(&sensor, (uint32_t)t_ms);
      printf("%d %d %d %d\n", e.value, e.lower, e.upper, e.flags);
    }
  } else {
    fprintf(stderr, "refused: status %d, see ss_status in softsensor.h\n", (int)status);
  }
  free(network), free(unit);
  return (int)status;
}
