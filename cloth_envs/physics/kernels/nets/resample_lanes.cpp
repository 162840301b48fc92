// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <cstring>
#include <vector>

#include "../base/geometry.hpp"
#include "../base/simd.hpp"
#include "resample.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;

// Lines of w old samples to lines of cols.count new ones, `width` apart: a vector of new samples at a time, whose old
// samples mostly lie in two vectors from the first of them on. `line` holds w samples and two vectors more, for lines
// so near the end that the vectors reach beyond it.
template <int n>
void along(const float* in, int lines, int w, const Taps& cols, float* line, float* wide, int width) {
  for (int c = 0; c < cols.count; c += kWide) {
    Places number[n], low = Places{} + w, high = {};
    F weight[n];
    for (int t = 0; t < n; ++t) {
      std::memcpy(&number[t], cols.index.data() + t * cols.stride + c, sizeof number[t]);
      weight[t] = load(cols.weight.data() + t * cols.stride + c);
      low = number[t] < low ? number[t] : low, high = number[t] > high ? number[t] : high;
    }
    int first = w, last = 0;
    for (int k = 0; k < kWide; ++k) first = std::min(first, int(low[k])), last = std::max(last, int(high[k]));
    for (int t = 0; t < n; ++t) number[t] -= first;
    const bool near = last - first < 2 * kWide;
    for (int r = 0; r < lines; ++r) {
      const float* from = in + r * w;
      if ((lines - r) * w < first + 2 * kWide) {
        std::copy_n(from + first, w - first, line + first);
        from = line;
      }
      F sum = {};
      if (near) {
        const F a = load(from + first), b = load(from + first + kWide);
#pragma GCC unroll 4
        for (int t = 0; t < n; ++t) sum += weight[t] * pick(a, b, number[t]);
      } else {
        for (int t = 0; t < n; ++t)
          for (int k = 0; k < kWide; ++k) sum[k] += weight[t][k] * from[first + number[t][k]];
      }
      store(wide + r * width + c, sum);
    }
  }
}

// One new line of every plane: the sum of `n` old lines times a weight each. Planes are `from` and `step` apart.
template <int n>
void across(const float* const* lines, const float* weights, int planes, int from, int step, int count, float* to) {
  F weight[n];
#pragma GCC unroll 4
  for (int t = 0; t < n; ++t) weight[t] = F{} + weights[t];
  const auto sum = [&](int c) __attribute__((always_inline)) {
    F all = weight[0] * load(lines[0] + c);
#pragma GCC unroll 4
    for (int t = 1; t < n; ++t) all += weight[t] * load(lines[t] + c);
    return all;
  };
  for (int p = 0; p < planes; ++p, to += step) {
    const int c = p * from;
    if (count < kWide) {
      const F all = sum(c);
      std::memcpy(to, &all, count * sizeof(float));
      continue;
    }
    for (int k = 0; k + kWide <= count; k += kWide) store(to + k, sum(c + k));
    if (count % kWide) store(to + count - kWide, sum(c + count - kWide));
  }
}

void resample(const float* in, int planes, int h, int w, const Taps& rows, const Taps& cols, float* out) {
  const int width = (cols.count + kWide - 1) / kWide * kWide;
  thread_local Plane<float> wide, line;
  wide.resize(planes * h * width);
  line.resize(w + 2 * kWide);
  constexpr decltype(&along<1>) kAlong[] = {along<1>, along<2>, along<3>, along<4>};
  kAlong[cols.taps - 1](in, planes * h, w, cols, line.data(), wide.data(), width);
  for (int r = 0; r < rows.count; ++r, out += cols.count) {
    const float* lines[kTaps];
    float weights[kTaps];
    int n = 0;
    for (int t = 0; t < rows.taps; ++t)
      if (const float weight = rows.weight[t * rows.stride + r]; weight != 0 || (n == 0 && t == rows.taps - 1))
        weights[n] = weight, lines[n++] = wide.data() + rows.index[t * rows.stride + r] * width;
    constexpr decltype(&across<1>) kAcross[] = {across<1>, across<2>, across<3>, across<4>};
    kAcross[n - 1](lines, weights, planes, h * width, rows.count * cols.count, cols.count, out);
  }
}

constexpr ResampleLanes instance = {resample};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ResampleLanes, instance)

}  // namespace minicloth
