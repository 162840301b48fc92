// Compiled once per instruction set; LANES names the namespace.
#include <cstring>

#include "../base/simd.hpp"
#include "../sheet/contact.hpp"
#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;

// Outward normals, gaps to the surface (negative inside) and velocities of a body at x.
struct Near {
  V3<float> normal, velocity;
  F gap;
};

Near near(const UpscaledBody& b, const V3<float>& x) {
  if (b.plane) {
    const V3<float> n = {F{} + b.ends[1][0], F{} + b.ends[1][1], F{} + b.ends[1][2]};
    return {n, axis_point<float>(b.velocities, F{}), dot(n, x - axis_point<float>(b.ends, F{})) - b.radius};
  }
  const F t = nearest<float>(b.ends, x);
  const V3<float> d = x - axis_point<float>(b.ends, t);
  const F square = dot(d, d), inverse = rsqrt(square + tiny<float>);
  V3<float> n = inverse * d;
  n.z += square > 0.0f ? F{} : F{} + 1.0f;  // up from the axis itself
  return {n, axis_point<float>(b.velocities, t), square * inverse - b.radius};
}

// Calls each(vertex, lane, what is near it) for those of the n vertices x whose gap is less than `reach`.
template <class Each>
void touching(const UpscaledBody& b, int n, const float* x, float reach, const Each& each) {
  const float outer = b.radius + reach, limit = outer * outer;
  const V3<float> point = axis_point<float>(b.ends, F{}), normal = axis_point<float>(b.ends, F{} + 1.0f);
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

constexpr ProjectionLanes instance = {push, stop};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ProjectionLanes, instance)

}  // namespace minicloth
