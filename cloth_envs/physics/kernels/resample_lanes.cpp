// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <vector>

#include "geometry.hpp"
#include "resample.hpp"
#include "simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
using I = decltype(F{} < F{});
constexpr int kWide = kLanes<float>;

// Lanes of (a, b), picked by number.
inline F pick(const F& a, const F& b, const I& number) {
#if defined(__clang__)
  F r;
  for (int k = 0; k < kWide; ++k) r[k] = number[k] < kWide ? a[number[k]] : b[number[k] - kWide];
  return r;
#else
  return __builtin_shuffle(a, b, number);
#endif
}

// Lines of w old samples to lines of cols.count new ones, `width` apart: a vector of new samples at a time, whose old
// samples mostly lie in two vectors from the first of them on. `line` holds w samples and two vectors more, for lines
// so near the end that the vectors reach beyond it.
void along(const float* in, int lines, int w, const Taps& cols, float* line, float* wide, int width) {
  for (int c = 0; c < cols.count; c += kWide) {
    const int some = std::min(kWide, cols.count - c);
    int first = w, last = 0;
    for (int t = 0; t < cols.taps; ++t)
      for (int k = 0; k < some; ++k) {
        const int old = cols.index[t * cols.count + c + k];
        first = std::min(first, old), last = std::max(last, old);
      }
    I number[kTaps] = {};
    F weight[kTaps] = {};
    for (int t = 0; t < cols.taps; ++t)
      for (int k = 0; k < some; ++k) {
        number[t][k] = cols.index[t * cols.count + c + k] - first;
        weight[t][k] = cols.weight[t * cols.count + c + k];
      }
    const bool near = last - first < 2 * kWide;
    for (int r = 0; r < lines; ++r) {
      const float* from = in + r * w;
      if ((lines - r) * w < first + 2 * kWide) {
        std::copy_n(from + first, w - first, line + first);
        from = line;
      }
      F sum[kTaps] = {};
      if (near) {
        const F a = load(from + first), b = load(from + first + kWide);
        for (int t = 0; t < kTaps; ++t) sum[t] = weight[t] * pick(a, b, number[t]);
      } else {
        for (int t = 0; t < cols.taps; ++t)
          for (int k = 0; k < some; ++k) sum[t][k] = weight[t][k] * from[first + number[t][k]];
      }
      store(wide + r * width + c, (sum[0] + sum[1]) + (sum[2] + sum[3]));
    }
  }
}

// to = the sum of `n` lines times a weight each. A whole number of vectors is written.
template <int n>
void add(const float* const* lines, const float* weights, int count, float* to) {
  const float* line[n];
  F weight[n];
#pragma GCC unroll 4
  for (int t = 0; t < n; ++t) line[t] = lines[t], weight[t] = F{} + weights[t];
  for (int c = 0; c < count; c += kWide) {
    F sum = weight[0] * load(line[0] + c);
#pragma GCC unroll 4
    for (int t = 1; t < n; ++t) sum += weight[t] * load(line[t] + c);
    store(to + c, sum);
  }
}

// New line r: the sum of taps over old lines `width` apart.
void across(const float* wide, int width, int r, const Taps& rows, int count, float* to) {
  const float* line[kTaps];
  float weight[kTaps];
  int n = 0;
  for (int t = 0; t < rows.taps; ++t)
    if (const float w = rows.weight[t * rows.count + r]; w != 0 || (n == 0 && t == rows.taps - 1))
      weight[n] = w, line[n++] = wide + rows.index[t * rows.count + r] * width;
  constexpr decltype(&add<1>) kAdd[] = {add<1>, add<2>, add<3>, add<4>};
  kAdd[n - 1](line, weight, count, to);
}

void resample(const float* in, int planes, int h, int w, const Taps& rows, const Taps& cols, float* out) {
  const int width = (cols.count + kWide - 1) / kWide * kWide;
  thread_local Plane<float> wide, line, end;
  wide.resize(planes * h * width);
  line.resize(w + 2 * kWide);
  end.resize(width);
  along(in, planes * h, w, cols, line.data(), wide.data(), width);
  for (int p = 0, left = planes * rows.count * cols.count; p < planes; ++p)
    for (int r = 0; r < rows.count; ++r, out += cols.count, left -= cols.count) {
      // What a line writes beyond its end is overwritten by the ones after it, if there are enough of them.
      across(wide.data() + p * h * width, width, r, rows, cols.count, left >= width ? out : end.data());
      if (left < width) std::copy_n(end.data(), cols.count, out);
    }
}

}  // namespace

Resample resample_lanes() { return resample; }

}  // namespace LANES
}  // namespace minicloth
