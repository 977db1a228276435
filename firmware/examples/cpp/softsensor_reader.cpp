// A reader of softcal's calibration files in C++17, without softsensor.h: written from docs/format.md alone.
//
//   g++ -std=c++17 -O2 softsensor_reader.cpp -o softsensor_reader
//   ./softsensor_reader network.ssc unit.ssc [serial] < codes.txt
//
// A line `time_ms code` per sample comes in, a line `value lower upper flags` goes out. A refused file ends with its
// cause as exit code. It runs on any byte order and needs no alignment.
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <deque>
#include <fstream>
#include <iostream>
#include <iterator>
#include <string>
#include <vector>

namespace {

constexpr int taps = 15;
constexpr int latest_minor = 0;
enum Cause { magic = 2, version, length, crc, kind, network_id, serial_number, layout, self_test };
enum Flag { warm_up = 1, stale = 4, out_of_range = 8, clamped = 16, wrong_rate = 32, stuck = 64 };

struct Refused {
  Cause cause;
  const char *text;
};

void need(bool holds, Cause cause, const char *text) {
  if (!holds) throw Refused{cause, text};
}

std::int64_t clip(std::int64_t x) { return std::clamp<std::int64_t>(x, -32767, 32767); }

// Rounds down, as an arithmetic shift does; right shifts of negative numbers say so only from C++20 on.
std::int64_t shifted(std::int64_t x, int by) { return x >= 0 ? x >> by : -((-x + (std::int64_t{1} << by) - 1) >> by); }

std::int64_t absolute(std::int64_t x) { return x < 0 ? -x : x; }

using Bytes = std::vector<std::uint8_t>;
using Window = std::vector<std::int64_t>;

class File {
 public:
  File(Bytes bytes, int wanted) : data(std::move(bytes)), end(data.size()) {
    need(data.size() >= 52, length, "shorter than its header");
    need(u32() == 0x46435353u, magic, "no calibration file");
    const int found = u8();
    need(u8() == 1, version, "another major version");
    minor = u8();
    u8();
    need(u32() == data.size() && data.size() % 4 == 0, length, "cut off");
    at = data.size() - 4;
    need(u32() == checksum(), crc, "damaged");
    need(found == wanted, kind, "network and unit file mixed up");
    end = data.size() - 4, at = 48;
  }

  std::uint8_t u8() {
    need(at < end, layout, "ends in the middle");
    return data[at++];
  }
  std::uint16_t u16() {
    const std::uint16_t low = u8();
    return static_cast<std::uint16_t>(low | u8() << 8);
  }
  std::uint32_t u32() {
    const std::uint32_t low = u16();
    return low | static_cast<std::uint32_t>(u16()) << 16;
  }
  std::int8_t i8() { return static_cast<std::int8_t>(u8()); }
  std::int16_t i16() { return static_cast<std::int16_t>(u16()); }
  std::int32_t i32() { return static_cast<std::int32_t>(u32()); }
  void skip(std::size_t count) {
    while (count--) u8();
  }
  void skip_to_four() {
    while (at % 4) u8();
  }
  void finish() const { need(at == end || minor > latest_minor, layout, "longer than its contents"); }
  std::string field(std::size_t from, std::size_t count) const {
    return {data.begin() + static_cast<std::ptrdiff_t>(from), data.begin() + static_cast<std::ptrdiff_t>(from + count)};
  }

 private:
  std::uint32_t checksum() const {
    std::uint32_t sum = 0xffffffffu;
    for (std::size_t k = 0; k + 4 < data.size(); k++) {
      sum ^= data[k];
      for (int bit = 0; bit < 8; bit++) sum = sum & 1 ? sum >> 1 ^ 0xedb88320u : sum >> 1;
    }
    return ~sum;
  }

  Bytes data;
  std::size_t at = 0, end;
  int minor = 0;
};

struct Row {
  std::int64_t bias, multiplier;
  int shift1, shift2;
  std::vector<std::int64_t> weights;
};

class Layer {
 public:
  Layer(File &file, std::size_t count, std::size_t columns) {
    rows.resize((count + 3) / 4 * 4);
    for (Row &row : rows) {
      row.bias = file.i32(), row.multiplier = file.u16();
      row.shift1 = file.u8(), row.shift2 = file.u8();
    }
    for (std::size_t block = 0; block < rows.size(); block += 4)
      for (std::size_t column = 0; column < columns; column++)
        for (std::size_t k = 0; k < 4; k++) rows[block + k].weights.push_back(file.i16());
    rows.resize(count);
    for (const Row &row : rows) prove(row);
  }

  Window apply(const Window &in, bool is_rectified) const {
    Window out;
    for (const Row &row : rows) {
      std::int64_t sum = row.bias;
      for (std::size_t k = 0; k < in.size(); k++) sum += row.weights[k] * in[k];
      if (is_rectified) sum = std::max<std::int64_t>(sum, 0);
      const std::int64_t product = shifted(sum, row.shift1) * row.multiplier;
      out.push_back(clip(shifted(product + (std::int64_t{1} << (row.shift2 - 1)), row.shift2)));
    }
    return out;
  }

 private:
  static void prove(const Row &row) {
    need(row.shift1 <= 31 && row.shift2 >= 1 && row.shift2 <= 31, layout, "a shift");
    need(row.multiplier >= 8192 && row.multiplier <= 16383, layout, "a multiplier");
    std::int64_t bound = absolute(row.bias);
    for (const std::int64_t weight : row.weights) bound += absolute(weight) * 32767;
    const std::int64_t product = ((bound >> row.shift1) + 1) * row.multiplier + (std::int64_t{1} << (row.shift2 - 1));
    need(bound < std::int64_t{1} << 31 && product < std::int64_t{1} << 31, layout, "a row could overflow");
  }

  std::vector<Row> rows;
};

struct Shape {
  std::array<std::int64_t, taps> weights;
  int shift;
  std::int64_t bias;  // in 1/64 counts
};

class Mix {
 public:
  explicit Mix(File &file) : keep(file.u8()), shapes(file.u8()) {
    need(!shapes.empty() && shapes.size() <= 6, layout, "shapes of a mix");
    file.u16();
    for (Shape &shape : shapes) {
      shape.bias = file.i32();
      for (std::int64_t &weight : shape.weights) weight = file.i16();
      shape.shift = file.u16();
      need(shape.shift <= 31, layout, "shift of a mix");
    }
  }

  Window apply(const Window &in) const {
    std::vector<std::int64_t> steps;
    for (const Shape &shape : shapes) {
      std::int64_t sum = 0;
      for (std::size_t k = 0; k < taps; k++) sum += shape.weights[k] * in[k];
      steps.push_back(shifted(sum, shape.shift) + shape.bias);
    }
    Window out;
    for (int tap = 0; tap < taps; tap++) {
      std::int64_t total = 0, before = 0;
      for (auto step = steps.rbegin(); step != steps.rend(); ++step) {
        const std::int64_t next = *step + shifted((tap - 7) * total, 2) - before;
        before = total, total = next;
      }
      out.push_back(clip(shifted(total + keep * in[static_cast<std::size_t>(tap)] + 32, 6)));
    }
    return out;
  }

 private:
  std::int64_t keep;
  std::vector<Shape> shapes;
};

struct Knot {
  std::int64_t code, count;
};

struct Band {
  std::int64_t level, minus, plus;
};

struct SelfTest {
  std::int64_t start, step, expected;
};

struct Estimate {
  std::int64_t value, lower, upper;
  int flags;
};

class Sensor {
 public:
  Sensor(File network, File unit, const char *serial) {
    need(network.field(12, 8) == unit.field(12, 8), network_id, "calibrated with another network");
    if (serial) {
      std::string wanted(serial);
      wanted.resize(std::max<std::size_t>(20, wanted.size()), '\0');
      need(wanted == unit.field(28, 20), serial_number, "the file of another unit");
    }
    read_network(network);
    const std::vector<SelfTest> tests = read_unit(unit);
    for (const SelfTest &test : tests) {
      Window window;
      for (int k = 0; k < taps; k++) window.push_back(on_sample(test.start + k * test.step));
      need(raw(window) == test.expected, self_test, "a self-test gives another number");
    }
  }

  void push(std::uint32_t code, std::uint32_t t_ms) {
    if (t_ms - last_ms > gap_ms) samples.clear();
    if (samples.empty() || code != last_code) is_stuck = false, moved_ms = t_ms;
    if (t_ms - moved_ms >= 60000) is_stuck = true;
    samples.push_back({code, t_ms});
    if (samples.size() > taps) samples.pop_front();
    last_ms = t_ms, last_code = code;
  }

  Estimate read(std::uint32_t now_ms) const {
    if (samples.size() < taps) return {0, 0, 0, warm_up};
    Window window;
    for (const Sample &sample : samples) window.push_back(on_sample(sample.code));
    const std::int64_t exact = raw(window), value = std::clamp(exact, out_min, out_max);
    auto band = std::find_if(bands.begin(), bands.end(), [&](const Band &b) { return b.level >= value; });
    if (band == bands.end()) --band;
    int flags = keeps_rate() ? 0 : wrong_rate;
    if (value != exact) flags |= clamped;
    if (now_ms - last_ms > gap_ms) flags |= stale;
    if (is_stuck) flags |= stuck;
    for (const Sample &sample : samples)
      if (sample.code < code_min || sample.code > code_max) flags |= out_of_range;
    return {value, std::max<std::int64_t>(value - band->minus, -32767),
            std::min<std::int64_t>(value + band->plus, 32767), flags};
  }

 private:
  struct Sample {
    std::uint32_t code, t_ms;
  };

  void read_network(File &file) {
    const std::size_t count = file.u8();
    need(file.u8() == 1 && file.u8() == taps && count >= 1 && count <= 7, layout, "layers");
    file.i8();
    std::array<std::size_t, 8> sizes;
    for (std::size_t &size : sizes) size = file.u16();
    need(sizes[0] == taps && sizes[count] == 1, layout, "sizes");
    for (std::size_t k = 0; k <= count; k++) need(sizes[k] >= 1 && sizes[k] <= 1024, layout, "sizes");
    gap_ms = file.u16();
    file.u16();
    period_us = file.u32();
    need(period_us > 0, layout, "no sample period");
    file.skip(4 + 4 + 8 + 8 + 32);
    for (std::size_t k = 0; k < count; k++) layers.emplace_back(file, sizes[k + 1], sizes[k]);
    file.skip(56);  // levels of the source: only a trim needs them
    file.finish();
  }

  std::vector<SelfTest> read_unit(File &file) {
    const int form = file.u8();
    const std::size_t knot_count = file.u8(), band_count = file.u8(), test_count = file.u8();
    need(form >= 1 && form <= 5, layout, "form of the map");
    need(form & 1 ? knot_count >= 2 && knot_count <= 32 : knot_count == 0, layout, "knots");
    need(band_count >= 1 && band_count <= 4 && test_count >= 1 && test_count <= 4, layout, "bands or self-tests");
    code_min = file.u16(), code_max = file.u16(), out_min = file.i16(), out_max = file.i16();
    need(code_min < code_max && out_min < out_max, layout, "ranges");
    file.skip(12);
    for (std::size_t k = 0; k < band_count; k++) {
      Band band{};
      band.level = file.i16(), band.minus = file.u16(), band.plus = file.u16();
      bands.push_back(band);
    }
    std::vector<SelfTest> tests(test_count);
    for (SelfTest &test : tests) test.start = file.u16(), test.step = file.i16(), test.expected = file.i16();
    file.skip_to_four();
    knots.resize(knot_count);
    for (Knot &knot : knots) knot.code = file.u16(), knot.count = file.i16();
    if (form & 2) linear.emplace_back(file, taps, taps);
    if (form & 4) mixes.emplace_back(file);
    file.finish();
    return tests;
  }

  std::int64_t on_sample(std::int64_t code) const {
    if (knots.empty()) return std::max<std::int64_t>(code - 32768, -32767);
    if (code <= knots.front().code) return knots.front().count;
    if (code >= knots.back().code) return knots.back().count;
    auto right = std::find_if(knots.begin(), knots.end(), [&](const Knot &knot) { return code < knot.code; });
    const Knot a = *(right - 1), b = *right;
    const std::int64_t span = b.code - a.code;
    const std::int64_t step = (absolute(b.count - a.count) * (code - a.code) + span / 2) / span;
    return b.count < a.count ? a.count - step : a.count + step;
  }

  std::int64_t raw(Window window) const {
    for (const Layer &layer : linear) window = layer.apply(window, false);
    for (const Mix &mix : mixes) window = mix.apply(window);
    for (std::size_t k = 0; k < layers.size(); k++) window = layers[k].apply(window, k + 1 < layers.size());
    return window[0];
  }

  bool keeps_rate() const {
    std::uint64_t sum = 0;
    for (std::size_t k = 1; k < samples.size(); k++) {
      const std::uint32_t step = samples[k].t_ms - samples[k - 1].t_ms;
      if (step < (period_us - 1) / 2000) return false;
      sum += step;
    }
    return sum + 1 >= 63 * period_us / 5000 && sum <= 77 * period_us / 5000 + 1;
  }

  std::uint32_t gap_ms = 0, last_ms = 0, moved_ms = 0, last_code = 0, code_min = 0, code_max = 0;
  std::uint64_t period_us = 0;
  std::int64_t out_min = 0, out_max = 0;
  bool is_stuck = false;
  std::vector<Layer> layers, linear;
  std::vector<Mix> mixes;
  std::vector<Knot> knots;
  std::vector<Band> bands;
  std::deque<Sample> samples;
};

Bytes contents(const char *name) {
  std::ifstream file(name, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

}  // namespace

int main(int count, char **arguments) {
  if (count < 3) {
    std::cerr << "use: " << arguments[0] << " network.ssc unit.ssc [serial] < codes.txt\n";
    return 64;
  }
  try {
    Sensor sensor(File(contents(arguments[1]), 1), File(contents(arguments[2]), 2), count > 3 ? arguments[3] : nullptr);
    std::uint32_t t_ms, code;
    while (std::cin >> t_ms >> code) {
      sensor.push(code, t_ms);
      const Estimate e = sensor.read(t_ms);
      std::cout << e.value << ' ' << e.lower << ' ' << e.upper << ' ' << e.flags << '\n';
    }
  } catch (const Refused &refusal) {
    std::cerr << "refused: " << refusal.text << " (cause " << refusal.cause << ")\n";
    return refusal.cause;
  }
  return EXIT_SUCCESS;
}
