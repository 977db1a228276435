/* A soft sensor on an Arduino (MKR1000, Zero, Nano 33 IoT, Uno R4, ...): one estimate every 20 ms over the serial port.
 *
 * 1. softcal export --serial A1 --format c --adc-bits 10 --adc-full-scale 3.3 --out sketch-files
 * 2. Copy softsensor.h, network-<id>.h and unit-A1.h beside this sketch, and correct the two names below.
 * 3. Upload, and open the serial plotter: estimate, lower and upper end of its 90 % interval.
 *
 * A board with less than 40 KB of flash needs a smaller network; an Uno R3 (AVR) is too small.
 */
#include "network-0123456789abcdef.h"
#include "unit-A1.h"

#include "softsensor.h"

static const uint8_t OUTPUT_PIN = A0;
static const uint8_t ADC_BITS = 10;    /* as in --adc-bits */
static const uint32_t PERIOD_MS = 20;  /* as the lot was recorded: 50 Hz */

static ss_sensor sensor;
static uint32_t next_ms;

void setup() {
  Serial.begin(115200);
  analogReadResolution(ADC_BITS);
  ss_status status = ss_open(&sensor, SS_NETWORK, SS_NETWORK_BYTES, SS_UNIT, SS_UNIT_BYTES, SS_UNIT_SERIAL);
  if (status != SS_OK) {
    Serial.print("calibration refused, ss_status ");
    Serial.println((int)status);
  }
  next_ms = millis();
}

void loop() {
  uint32_t now_ms = millis();
  if ((int32_t)(now_ms - next_ms) < 0) return;
  next_ms += PERIOD_MS;

  uint16_t code = (uint16_t)(analogRead(OUTPUT_PIN) << (16 - ADC_BITS)); /* left-aligned to 16 bits */
  ss_push(&sensor, code, now_ms);

  ss_estimate e = ss_read(&sensor, now_ms);
  if (e.flags & SS_NO_NUMBER) return;
  Serial.print(e.value);
  Serial.print(' ');
  Serial.print(e.lower);
  Serial.print(' ');
  Serial.print(e.upper);
  Serial.print(' ');
  Serial.println(e.flags);
}
