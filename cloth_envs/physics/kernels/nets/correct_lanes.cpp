// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <cmath>

#include "../base/simd.hpp"
#include "correct.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;
constexpr float kFar = 6.0f;  // spacings beyond which a body is not seen

V3<float> unit(const V3<float>& a) { return rsqrt(dot(a, a) + 1e-12f) * a; }

V3<float> gather(const float* field, int n, const int* at) {
  V3<float> out;
  for (int k = 0; k < kWide; ++k) {
    const int i = at[k];
    out.x[k] = field[i], out.y[k] = field[i + n], out.z[k] = field[i + 2 * n];
  }
  return out;
}

// Two tangents evenly about the sheet's lines, and the normal, from the nearest along and across.
void axes_of(const V3<float>* near, V3<float>* axes) {
  const V3<float> across = near[0] - near[1], along = near[2] - near[3];
  axes[2] = unit(cross(across, along));
  V3<float> middle = unit(across) + unit(along);
  middle = unit(middle - dot(middle, axes[2]) * axes[2]);
  const V3<float> side = cross(axes[2], middle);
  const F half = F{} + 0.70710678f;
  axes[0] = half * (middle - side), axes[1] = half * (middle + side);
}

F clip(const F& a, const F& low, const F& high) {
  const F b = a < low ? low : a;
  return b > high ? high : b;
}

// The answers of all vertices, (6, width).
void infer(const Correct& net, const float* x, const float* u, const float* change, const Surroundings& around,
           float* out) {
  const int n = net.vertices;
  const F per = F{} + 1.0f / net.spacing, pace = F{} + net.frame_dt / net.spacing;
  for (int i = 0; i < net.width; i += kWide) {
    int here[kWide];
    for (int k = 0; k < kWide; ++k) here[k] = std::min(i + k, n - 1);
    const int* at = net.index.data() + i;
    const V3<float> x0 = gather(x, n, here), u0 = gather(u, n, here), c0 = gather(change, n, here);
    V3<float> near[32], axes[3];
    for (int p = 0; p < net.near; ++p, at += net.width) near[p] = per * (gather(x, n, at) - x0);
    axes_of(near, axes);
    F numbers[2][kWidest];
    F* to = numbers[0];
    const auto put = [&](const V3<float>& a) {
      for (const auto& axis : axes) *to++ = dot(axis, a);
    };
    for (int p = 0; p < net.near; ++p) put((F{} + net.nearer[p]) * near[p]);
    for (int p = 0; p < net.moving; ++p, at += net.width) put(gather(u, n, at) - u0);
    for (int p = 0; p < net.changing; ++p, at += net.width) put(gather(change, n, at) - c0);
    put(u0), put(c0), put({F{}, F{}, F{} + 1.0f});
    const auto all = [](const float* a) { return V3<float>{F{} + a[0], F{} + a[1], F{} + a[2]}; };
    if (net.wind) put(pace * all(around.wind));
    F distances[16];
    const int bodies = int(net.radii.size());
    for (int b = 0; b < bodies; ++b) {
      const float* ends = around.bodies + 6 * b;
      const V3<float> gap = x0 - all(ends);
      if (net.planes[b]) {
        distances[b] = per * dot(gap, all(ends + 3));
        continue;
      }
      const F square = dot(gap, gap), inverse = rsqrt(square + tiny<float>);
      distances[b] = per * (square * inverse - net.radii[b]);
      F fade = clip(distances[b], F{}, F{} + kFar);
      for (int k = 0; k < kWide; ++k) fade[k] = std::exp(-0.5f * fade[k]);
      put((fade * inverse) * gap);
    }
    for (int p = 0; p < net.places; ++p) *to++ = load(net.place.data() + p * net.width + i);
    for (int b = 0; b < bodies; ++b) *to++ = clip(distances[b], F{} - 1.0f, F{} + kFar);
    for (int f = 0; f < net.layers[0].inputs; ++f)
      numbers[0][f] = clip(numbers[0][f], F{} + net.low[f], F{} + net.high[f]);
    dense<true>(net.layers[0], net.biases[0].data(), numbers[0], numbers[1]);
    dense<true>(net.layers[1], net.biases[1].data(), numbers[1], numbers[0]);
    dense<false>(net.layers[2], net.biases[2].data(), numbers[0], numbers[1]);
    F* y = numbers[1];
    const F share = net.spacing * load(net.share.data() + i);
    for (int k = 0; k < 6; ++k) {
      const F part = (1.0f / net.limit[k]) * y[k];
      y[k] = (share * y[k]) * rsqrt(1.0f + part * part);
    }
    for (int half = 0; half < 2; ++half, y += 3) {
      const V3<float> a = y[0] * axes[0] + (y[1] * axes[1] + y[2] * axes[2]);
      float* put_at = out + 3 * half * net.width + i;
      store(put_at, a.x), store(put_at + net.width, a.y), store(put_at + 2 * net.width, a.z);
    }
  }
}

void correct(const Correct& net, const float* old, const Surroundings& around, float* x, float* v) {
  const int n = net.vertices;
  thread_local Plane<float> memory;
  memory.resize(6 * std::size_t(n) + 6 * std::size_t(net.width));
  float *u = memory.data(), *change = u + 3 * n, *out = change + 3 * n;
  const float pace = net.frame_dt / net.spacing;
  for (int i = 0; i < 3 * n; ++i) u[i] = pace * v[i], change[i] = pace * (v[i] - old[i]);
  infer(net, x, u, change, around, out);
  const float per = 1.0f / net.frame_dt;
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < n; ++i) {
      x[k * n + i] += out[k * net.width + i];
      v[k * n + i] += per * out[(k + 3) * net.width + i];
    }
}

constexpr CorrectLanes instance = {correct};

}  // namespace
}  // namespace LANES

DEFINE_LANES(CorrectLanes, instance)

}  // namespace minicloth
