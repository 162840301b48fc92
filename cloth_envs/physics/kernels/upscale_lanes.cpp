// Compiled once per instruction set; LANES names the namespace.
#include <cstring>

#include "nearest.hpp"
#include "upscale.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;

// y = W x + b, and 0 where that is negative if kCut; one lane a patch. Writes whole blocks of outputs.
template <bool kCut>
void dense(const DenseLayer& layer, const float* bias, const F* x, F* y) {
  const float* w = layer.weights.data();
  for (int j = 0; j < layer.outputs; j += kUnits) {
    F sum[kUnits] = {};
    for (int f = 0; f < layer.inputs; ++f, w += kUnits) {
      const F in = x[f];
#pragma GCC unroll 9
      for (int k = 0; k < kUnits; ++k) sum[k] += w[k] * in;
    }
#pragma GCC unroll 9
    for (int k = 0; k < kUnits; ++k) {
      const F value = sum[k] + (j + k < layer.outputs ? bias[j + k] : 0.0f);
      y[j + k] = kCut ? (value > 0.0f ? value : F{}) : value;
    }
  }
}

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
    (l < last ? dense<true> : dense<false>)(layer, bias, numbers[l % 2], numbers[(l + 1) % 2]);
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

// Outward normals, gaps to the surface (negative inside) and velocities of a body at x.
struct Near {
  V3<float> normal, velocity;
  F gap;
};

Near near(const UpscaledBody& b, const V3<float>& x) {
  if (b.plane) {
    const V3<float> n = {F{} + b.ends[1][0], F{} + b.ends[1][1], F{} + b.ends[1][2]};
    return {n, axis_point(b.velocities, F{}), dot(n, x - axis_point(b.ends, F{})) - b.radius};
  }
  const F t = nearest(b.ends, x);
  const V3<float> d = x - axis_point(b.ends, t);
  const F square = dot(d, d), inverse = rsqrt(square + tiny<float>);
  V3<float> n = inverse * d;
  n.z += square > 0.0f ? F{} : F{} + 1.0f;  // up from the axis itself
  return {n, axis_point(b.velocities, t), square * inverse - b.radius};
}

// Calls each(vertex, lane, what is near it) for those of the n vertices x whose gap is less than `reach`.
template <class Each>
void touching(const UpscaledBody& b, int n, const float* x, float reach, const Each& each) {
  const float outer = b.radius + reach, limit = outer * outer;
  const V3<float> point = axis_point(b.ends, F{}), normal = axis_point(b.ends, F{} + 1.0f);
  const bool ball = !b.plane && std::memcmp(b.ends[0], b.ends[1], sizeof b.ends[0]) == 0;
  for (int i = 0; i < n; i += kWide) {
    const int count = n - i < kWide ? n - i : kWide;
    V3<float> at;
    if (count == kWide) {
      at = {load(x + i), load(x + i + n), load(x + i + 2 * n)};
    } else {
      for (int k = 0; k < kWide; ++k)
        for (int a = 0; a < 3; ++a) (a == 0 ? at.x : a == 1 ? at.y : at.z)[k] = x[i + a * n + (k < count ? k : 0)];
    }
    const V3<float> d = at - point;  // a quick test of most vertices, which are far
    if (b.plane ? !any<float>(dot(normal, d) < outer) : ball && !any<float>(dot(d, d) < limit)) continue;
    const Near to = near(b, at);
    const auto close = to.gap < reach;
    for (int k = 0; k < count; ++k)
      if (close[k]) each(i + k, k, to);
  }
}

Pushed push(const UpscaledBody& b, int n, float* x) {
  Pushed all = {0, 0};
  touching(b, n, x, 0.0f, [&](int i, int k, const Near& to) {
    const float depth = -to.gap[k];
    ++all.count;
    if (depth > all.depth) all.depth = depth;
    x[i] += depth * to.normal.x[k], x[i + n] += depth * to.normal.y[k], x[i + 2 * n] += depth * to.normal.z[k];
  });
  return all;
}

void stop(const UpscaledBody& b, int n, const float* x, float* v, float reach) {
  touching(b, n, x, reach, [&](int i, int k, const Near& to) {
    const float m[3] = {to.normal.x[k], to.normal.y[k], to.normal.z[k]};
    const float u[3] = {to.velocity.x[k], to.velocity.y[k], to.velocity.z[k]};
    float in = 0;
    for (int a = 0; a < 3; ++a) in += m[a] * (v[i + a * n] - u[a]);
    for (int a = 0; a < 3 && in < 0; ++a) v[i + a * n] -= in * m[a];
  });
}

const UpscaleLanes table = {upscale, push, stop};

}  // namespace

const UpscaleLanes& upscale_lanes() { return table; }

}  // namespace LANES
}  // namespace minicloth
