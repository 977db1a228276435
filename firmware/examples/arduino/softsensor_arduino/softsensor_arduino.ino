/* A soft sensor on an Arduino (MKR1000, Zero, Nano 33 IoT, Uno, Mega, ...): one estimate every 20 ms over the serial port.
 *
 * 1. softcal export --serial A1 --format c --adc-bits 10 --adc-full-scale 3.3 --out sketch-files
 * 2. Copy softsensor.h, network-<id>.h and unit-A1.h beside this sketch, and correct the two names below.
 * 3. Upload, and open the serial plotter: estimate, lower and upper end of its 90 % interval, flags.
 *
 * An Uno R3 or a Mega (AVR) takes a small network (softcal train --hidden 16,8), its full scale is 5.0 V.
 */
#include "network-0123456789abcdef.h"
#include "unit-A1.h"

#include "softsensor.h"

static const uint8_t OUTPUT_PIN = A0;
static const uint8_t ADC_BITS = 10;    /* as in --adc-bits */
static const uint32_t PERIOD_MS = 20;  /* as the lot was recorded: 50 Hz */

static ss_sensor sensor;
static uint32_t due_ms;

void setup() {
  Serial.begin(115200);
#if !defined(__AVR__)
  analogReadResolution(ADC_BITS);
#endif
  ss_status status = ss_open(&sensor, SS_NETWORK, SS_NETWORK_BYTES, SS_UNIT, SS_UNIT_BYTES, SS_UNIT_SERIAL);
  if (status != SS_OK) {
    Serial.print("calibration refused, ss_status ");
    Serial.println((int)status);
  }
  due_ms = millis();
}

void loop() {
  const uint32_t now_ms = millis();
  const uint32_t late_ms = now_ms - due_ms;
  if (late_ms & 0x80000000UL) return; /* not yet; right also where millis() wraps, after 49.7 days */
  /* After a stall begin a new row of samples, and a new window: to catch up would squeeze the samples together. */
  if (late_ms > PERIOD_MS / 2) {
    due_ms = now_ms;
    ss_restart(&sensor);
  }
  due_ms += PERIOD_MS;

  const uint16_t code = (uint16_t)((uint16_t)analogRead(OUTPUT_PIN) << (16 - ADC_BITS)); /* left-aligned to 16 bits */
  ss_push(&sensor, code, now_ms);

  const ss_estimate e = ss_read(&sensor, now_ms);
  if (e.flags & SS_NO_NUMBER) return;
  Serial.print(e.value);
  Serial.print(' ');
  Serial.print(e.lower);
  Serial.print(' ');
  Serial.print(e.upper);
  Serial.print(' ');
  Serial.println(e.flags);
}
