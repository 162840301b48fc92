// Compiled once per instruction set; LANES names the namespace.
#include <cstring>

#include "../base/simd.hpp"
#include "patch.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;

// The coarse sheet with one more row and column all around, where a parabola continues it: to[axis], `plane` apart.
void pad(const float* x, int rows, int cols, std::size_t plane, float* to) {
  const int wide = cols + 2;
  for (int k = 0; k < 3; ++k, to += plane) {
    float* line = to + wide;
    for (int r = 0; r < rows; ++r, x += cols, line += wide) {
      std::memcpy(line + 1, x, cols * sizeof(float));
      line[0] = 3 * (line[1] - line[2]) + line[3];
      line[cols + 1] = 3 * (line[cols] - line[cols - 1]) + line[cols - 2];
    }
    const auto extend = [&](float* end, int step) {
      for (int c = 0; c < wide; ++c) end[c] = 3 * (end[c + step] - end[c + 2 * step]) + end[c + 3 * step];
    };
    extend(to, wide), extend(line, -wide);
  }
}

// Of each padded row the n = cols - 1 numbers from j on, for j = 0 to 3, so that all patches are contiguous: vertex
// (i, j) of patch q, of which n lie in a row, is to[axis][j][q + i n]. `each` is the size of such a part.
void line_up(const float* padded, int rows, int cols, std::size_t plane, std::size_t each, float* to) {
  const int n = cols - 1;
  for (int k = 0; k < 3; ++k, padded += plane)
    for (int j = 0; j < 4; ++j, to += each)
      for (int r = 0; r < rows + 2; ++r)  // whole vectors: the next row overwrites what is too much
        for (int c = 0; c < n; c += kWide) store(to + r * n + c, load(padded + r * (cols + 2) + j + c));
}

V3<float> unit(const V3<float>& a) { return rsqrt(dot(a, a) + tiny<float>) * a; }

// Right-handed axes of a patch; the first two lie as evenly about its mean edges along columns and rows as right angles
// allow, so that neither is preferred.
void tangent_axes(const V3<float>* x, V3<float>* axes) {
  const V3<float> a = unit((x[4] + x[8]) - (x[3] + x[7])), b = unit((x[7] + x[8]) - (x[3] + x[4]));
  const V3<float> u = unit(a + b), d = a - b, v = unit(d - dot(u, d) * u);
  const F half = F{} + 0.70710678f;
  axes[0] = half * (u + v), axes[1] = half * (u - v), axes[2] = cross(axes[0], axes[1]);
}

// Residuals at the nodes of kWide patches that follow each other, in the planes out[node][axis]; they are shortened,
// to net.limit at most.
void infer(const PatchNet& net, const float* patches, std::size_t each, int n, const float* bias, std::size_t area,
           float* out) {
  V3<float> x[kPoints], axes[3];
  V3<float> mean = {};
  for (int i = 0; i < kPoints; ++i) {
    constexpr int kPlaces[kPoints] = {1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14};
    const float* p = patches + kPlaces[i] % 4 * each + kPlaces[i] / 4 * n;
    x[i] = {load(p), load(p + 4 * each), load(p + 8 * each)};
    mean = mean + x[i];
  }
  tangent_axes(x, axes);
  const F share = F{} + 1.0f / kPoints, size = F{} + net.spacing, per = F{} + 1.0f / net.spacing;
  mean = share * mean;
  F numbers[2][kWidest];
  for (int i = 0; i < kPoints; ++i) {
    const V3<float> d = per * (x[i] - mean);
    for (int k = 0; k < 3; ++k) numbers[0][k * kPoints + i] = dot(axes[k], d);
  }
  const int last = int(net.layers.size()) - 1;
  for (int l = 0; l <= last; ++l) {
    const auto& layer = net.layers[l];
    if (l < last)
      dense<true>(layer, bias, numbers[l % 2], numbers[(l + 1) % 2]);
    else
      dense<false>(layer, bias, numbers[l % 2], numbers[(l + 1) % 2]);
    bias += layer.outputs;
  }
  const F* y = numbers[(last + 1) % 2];
  const F tight = F{} + 1.0f / (net.limit * net.limit);
  for (int i = 0; i < kNodes; ++i, out += 3 * area) {
    const F a = y[i], b = y[kNodes + i], c = y[2 * kNodes + i];
    const F scale = size * rsqrt(1.0f + tight * (a * a + (b * b + c * c)));
    const V3<float> r = scale * (a * axes[0] + (b * axes[1] + c * axes[2]));
    store(out, r.x), store(out + area, r.y), store(out + 2 * area, r.z);
  }
}

// Bicubic interpolation at half the spacing, as cloth_envs.resample has it, and the mean of what the cells around every
// vertex add to it.
void merge(const float* padded, std::size_t plane, const float* planes, std::size_t area, int rows, int cols,
           float* out) {
  const int n = cols - 1, wide = cols + 2, count = 2 * n + 1;
  thread_local Plane<float> memory;
  memory.resize(rows * wide + count + 4 * kWide);
  float *between = memory.data(), *end = between + rows * wide + kWide;
  Places low, high;  // a0 b0 a1 b1 ...
  for (int k = 0; k < kWide; ++k) low[k] = k / 2 + k % 2 * kWide, high[k] = low[k] + kWide / 2;
  const auto cubic = [](const float* p, int step) __attribute__((always_inline)) {
    return 0.5625f * (load(p + step) + load(p + 2 * step)) - 0.0625f * (load(p) + load(p + 3 * step));
  };
  for (int k = 0, missing = 3 * (2 * rows - 1) * count; k < 3; ++k) {
    const float* whole = padded + k * plane;
    for (int c = 0; c < (rows - 1) * wide; c += kWide) store(between + c, cubic(whole + c, wide));
    for (int line = 0; line < 2 * rows - 1; ++line, out += count, missing -= count) {
      const int r = line / 2;
      const float* v = line % 2 == 1 ? between + r * wide : whole + (r + 1) * wide;
      // At the left, in the middle and at the right of every cell the mean of what the cells above and below say.
      const float *above[3], *below[3];
      for (int j = 0; j < 3; ++j) {
        const auto said = [&](int row, int i) { return planes + ((i * 3 + j) * 3 + k) * area + row * n; };
        below[j] = line == 2 * rows - 2 ? said(r - 1, 2) : said(r, line % 2);
        above[j] = line % 2 == 1 || line == 0 ? below[j] : said(r - 1, 2);
      }
      const auto mean = [&](int j, int c)
                            __attribute__((always_inline)) { return 0.5f * (load(above[j] + c) + load(below[j] + c)); };
      // What a line writes beyond its end is overwritten by the ones after it, if there are enough of them.
      float* to = missing < count + 2 * kWide ? end : out;
      for (int c = 0; c <= n; c += kWide) {
        const F even = load(v + c + 1) + 0.5f * (mean(2, c - 1) + mean(0, c)), odd = cubic(v + c, 1) + mean(1, c);
        store(to + 2 * c, pick(even, odd, low)), store(to + 2 * c + kWide, pick(even, odd, high));
      }
      to[0] = v[1] + 0.5f * (above[0][0] + below[0][0]);
      to[2 * n] = v[n + 1] + 0.5f * (above[2][n - 1] + below[2][n - 1]);
      if (to == end) std::memcpy(out, end, count * sizeof(float));
    }
  }
}

void upscale(const PatchNet& net, const float* x, int rows, int cols, const float* bias, float* out) {
  const int n = cols - 1, cells = (rows - 1) * n;
  const std::size_t plane = std::size_t(rows + 2) * (cols + 2) + kBlock, each = std::size_t(rows + 3) * n + kBlock;
  // An odd number of blocks, or planes would share few lines of the cache.
  const std::size_t area = (std::size_t(cells + kBlock - 1) / kBlock | 1) * kBlock;
  thread_local Plane<float> padded, patches, planes;
  padded.resize(3 * plane), patches.resize(12 * each), planes.resize(3 * kNodes * area + 2 * kBlock);
  pad(x, rows, cols, plane, padded.data());
  line_up(padded.data(), rows, cols, plane, each, patches.data());
  for (int p = 0; p < cells; p += kWide) infer(net, patches.data() + p, each, n, bias, area, planes.data() + p);
  merge(padded.data(), plane, planes.data(), area, rows, cols, out);
}

constexpr PatchLanes instance = {upscale};

}  // namespace
}  // namespace LANES

DEFINE_LANES(PatchLanes, instance)

}  // namespace minicloth
