// Compiled once per instruction set; LANES names the namespace.
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
#pragma GCC unroll 8
      for (int k = 0; k < kUnits; ++k) sum[k] += w[k] * in;
    }
#pragma GCC unroll 8
    for (int k = 0; k < kUnits; ++k) {
      const F value = sum[k] + (j + k < layer.outputs ? bias[j + k] : 0.0f);
      y[j + k] = kCut ? (value > 0.0f ? value : F{}) : value;
    }
  }
}

// The coarse sheet with one more row and column all around, where a parabola continues it: (3, rows + 2, cols + 2).
void pad(const float* x, int rows, int cols, std::size_t plane, float* to) {
  const int stride = cols + 2;
  for (int k = 0; k < 3; ++k, to += plane) {
    for (int r = 0; r < rows; ++r, x += cols) {
      float* line = to + (r + 1) * stride;
      for (int c = 0; c < cols; ++c) line[c + 1] = x[c];
      line[0] = 3 * (line[1] - line[2]) + line[3];
      line[cols + 1] = 3 * (line[cols] - line[cols - 1]) + line[cols - 2];
    }
    float *first = to, *last = to + (rows + 1) * stride;
    for (int c = 0; c < stride; ++c) {
      first[c] = 3 * (first[stride + c] - first[2 * stride + c]) + first[3 * stride + c];
      last[c] = 3 * (last[c - stride] - last[c - 2 * stride]) + last[c - 3 * stride];
    }
    for (float* p = last + stride; p < to + plane; ++p) *p = 0;
  }
}

V3<float> unit(const V3<float>& a) { return rsqrt(dot(a, a) + tiny<float>) * a; }

// Right-handed axes of a patch; the first two lie as evenly about its mean edges along columns and rows as right angles
// allow, so that neither is preferred.
void tangent_axes(const V3<float>* x, V3<float>* axes) {
  const V3<float> a = unit((x[6] + x[10]) - (x[5] + x[9])), b = unit((x[9] + x[10]) - (x[5] + x[6]));
  const V3<float> u = unit(a + b), d = a - b, v = unit(d - dot(u, d) * u);
  const F half = F{} + 0.70710678f;
  axes[0] = half * (u + v), axes[1] = half * (u - v), axes[2] = cross(axes[0], axes[1]);
}

// Residuals at the (s+1)^2 vertices that kWide neighbouring cells span, in the patches' planes out[node][axis].
void infer(const PatchNet& net, const float* padded, std::size_t plane, int stride, const float* bias, const F& counts,
           std::size_t area, float* out) {
  V3<float> x[kPoints], axes[3];
  V3<float> mean = {};
  for (int i = 0; i < kPoints; ++i) {
    const float* p = padded + (i / 4) * stride + i % 4;
    x[i] = {load(p), load(p + plane), load(p + 2 * plane)};
    mean = mean + x[i];
  }
  tangent_axes(x, axes);
  const F share = F{} + 1.0f / kPoints, size = F{} + net.spacing, per = 1.0f / size;
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
  const int nodes = (net.factor + 1) * (net.factor + 1);
  const F scale = counts > 0.0f ? size : F{};
  for (int i = 0; i < nodes; ++i, out += 3 * area) {
    const V3<float> r = scale * (y[i] * axes[0] + (y[nodes + i] * axes[1] + y[2 * nodes + i] * axes[2]));
    store(out, r.x), store(out + area, r.y), store(out + 2 * area, r.z);
  }
}

// Adds to every fine vertex the mean of what the cells around it say; cells that do not exist say 0.
template <int s>
void merge(const float* planes, std::size_t area, int stride, int rows, int cols, float* out) {
  const int wide = s * (cols - 1) + 1;
  for (int k = 0; k < 3; ++k) {
    const auto node = [&](int i, int j) { return planes + ((i * (s + 1) + j) * 3 + k) * area; };
    for (int r = 0; r < rows; ++r)
      for (int i = 0; i < (r + 1 < rows ? s : 1); ++i, out += wide) {
        const int p = r * stride;
        const float down = i == 0 && r > 0 && r + 1 < rows ? 0.5f : 1.0f;
        for (int j = 0; j < s; ++j) {
          const float *own = node(i, j) + p, *above = node(s, j) + p - stride;
          const float *left = node(i, s) + p - 1, *corner = node(s, s) + p - stride - 1;
          const int count = j == 0 ? cols : cols - 1;
          const float share = j == 0 ? 0.5f * down : down;
          if (j > 0 && i > 0)
            for (int c = 0; c < count; ++c) out[c * s + j] += own[c];
          else if (j > 0)
            for (int c = 0; c < count; ++c) out[c * s + j] += share * (own[c] + above[c]);
          else if (i > 0)
            for (int c = 0; c < count; ++c) out[c * s] += (c > 0 && c + 1 < cols ? share : down) * (own[c] + left[c]);
          else
            for (int c = 0; c < count; ++c)
              out[c * s] += (c > 0 && c + 1 < cols ? share : down) * ((own[c] + left[c]) + (above[c] + corner[c]));
        }
      }
  }
}

void detail(const PatchNet& net, const float* x, int rows, int cols, const float* bias, float* out) {
  // Cell (r, c) is number r * stride + c; the three numbers at the end of each row are no cells.
  const int stride = cols + 2, cells = (rows - 2) * stride + cols - 1, nodes = (net.factor + 1) * (net.factor + 1);
  const int lead = (stride + 1 + kBlock) / kBlock * kBlock;  // before the first cell
  const std::size_t plane = std::size_t(rows + 2) * stride + kWide;
  const std::size_t area = std::size_t(lead + rows * stride + 2 * kBlock) / kBlock * kBlock;
  thread_local Plane<float> padded, planes, exists;
  padded.resize(3 * plane), planes.resize(3 * nodes * area), exists.assign(cells + kWide, 0.0f);
  pad(x, rows, cols, plane, padded.data());
  for (int r = 0; r + 1 < rows; ++r)
    for (int c = 0; c + 1 < cols; ++c) exists[r * stride + c] = 1;
  int p = 0;
  for (; p < cells; p += kWide)
    infer(net, padded.data() + p, plane, stride, bias, load(exists.data() + p), area, planes.data() + lead + p);
  for (int k = 0; k < 3 * nodes; ++k) {
    float* each = planes.data() + k * area;
    for (int i = 0; i < lead; ++i) each[i] = 0;
    for (std::size_t i = lead + p; i < area; ++i) each[i] = 0;
  }
  const auto put = net.factor == 2 ? merge<2> : net.factor == 3 ? merge<3> : merge<4>;
  put(planes.data() + lead, area, stride, rows, cols, out);
}

// Outward normals, gaps to the surface (negative inside) and velocities of a body at x.
struct Near {
  V3<float> normal, velocity;
  F gap;
};

Near near(const UpscaledBody& b, const V3<float>& x) {
  if (b.plane) {
    const V3<float> n = {F{} + b.ends[1][0], F{} + b.ends[1][1], F{} + b.ends[1][2]};
    const V3<float> point = axis_point(b.ends, F{});
    return {n, axis_point(b.velocities, F{}), dot(n, x - point) - b.radius};
  }
  const F t = nearest(b.ends, x);
  const V3<float> d = x - axis_point(b.ends, t);
  const F square = dot(d, d), inverse = rsqrt(square + tiny<float>);
  V3<float> n = inverse * d;
  n.z += square > 0.0f ? F{} : F{} + 1.0f;  // up from the axis itself
  return {n, axis_point(b.velocities, t), square * inverse - b.radius};
}

// Calls each(x, i, lanes that exist) for all of n vertices; the last ones in a copy.
template <class Each>
void blocks(int n, const float* x, const Each& each) {
  for (int i = 0; i < n; i += kWide) {
    const int count = n - i < kWide ? n - i : kWide;
    V3<float> at = {};
    F exists = {};
    if (count == kWide) {
      at = {load(x + i), load(x + i + n), load(x + i + 2 * n)}, exists = exists + 1.0f;
    } else {
      for (int k = 0; k < count; ++k)
        at.x[k] = x[i + k], at.y[k] = x[i + k + n], at.z[k] = x[i + k + 2 * n], exists[k] = 1;
    }
    each(at, i, count, exists);
  }
}

Pushed push(const UpscaledBody& b, int n, float* x) {
  Pushed all = {0, 0};
  blocks(n, x, [&](const V3<float>& at, int i, int count, const F& exists) {
    const Near to = near(b, at);
    const F depth = (exists > 0.0f) & (to.gap < 0.0f) ? -to.gap : F{};
    bool any = false;
    for (int k = 0; k < kWide; ++k) any |= depth[k] > 0;
    if (!any) return;
    for (int k = 0; k < count; ++k) {
      if (!(depth[k] > 0)) continue;
      ++all.count;
      if (depth[k] > all.depth) all.depth = depth[k];
      x[i + k] += depth[k] * to.normal.x[k], x[i + k + n] += depth[k] * to.normal.y[k];
      x[i + k + 2 * n] += depth[k] * to.normal.z[k];
    }
  });
  return all;
}

void stop(const UpscaledBody& b, int n, const float* x, float* v, float reach) {
  blocks(n, x, [&](const V3<float>& at, int i, int count, const F& exists) {
    const Near to = near(b, at);
    const auto touching = (exists > 0.0f) & (to.gap < reach);
    for (int k = 0; k < count; ++k) {
      if (!touching[k]) continue;
      const float m[3] = {to.normal.x[k], to.normal.y[k], to.normal.z[k]};
      const float u[3] = {to.velocity.x[k], to.velocity.y[k], to.velocity.z[k]};
      float in = 0;
      for (int a = 0; a < 3; ++a) in += m[a] * (v[i + k + a * n] - u[a]);
      for (int a = 0; a < 3 && in < 0; ++a) v[i + k + a * n] -= in * m[a];
    }
  });
}

const UpscaleLanes table = {detail, push, stop};

}  // namespace

const UpscaleLanes& upscale_lanes() { return table; }

}  // namespace LANES
}  // namespace minicloth
