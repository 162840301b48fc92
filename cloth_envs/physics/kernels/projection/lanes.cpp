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

// Calls each(first vertex, lanes, which of them, what is near them) where the gap of some of the n vertices x is less
// than `reach`.
template <class Each>
void touching(const UpscaledBody& b, int n, const float* x, float reach, const Each& each) {
  const float outer = b.radius + reach, limit = outer * outer;
  const V3<float> point = axis_point<float>(b.ends, F{}), normal = axis_point<float>(b.ends, F{} + 1.0f);
  const bool ball = !b.plane && std::memcmp(b.ends[0], b.ends[1], sizeof b.ends[0]) == 0;
  Places lane;
  for (int k = 0; k < kWide; ++k) lane[k] = k;
  for (int i = 0; i < n; i += kWide) {
    const int count = n - i < kWide ? n - i : kWide;
    const V3<float> at = {load_few(x + i, count), load_few(x + i + n, count), load_few(x + i + 2 * n, count)};
    const V3<float> d = at - point;  // a quick test of most vertices, which are far
    if (b.plane ? !any<float>(dot(normal, d) < outer) : ball && !any<float>(dot(d, d) < limit)) continue;
    const Near to = near(b, at);
    const Places close = (to.gap < reach) & (lane < count);
    if (any<float>(close)) each(i, count, close, to);
  }
}

Pushed push(const UpscaledBody& b, int n, float* x) {
  Places pushed = {};
  F deepest = {};
  touching(b, n, x, 0.0f, [&](int i, int count, const Places& close, const Near& to) {
    const F depth = close ? -to.gap : F{}, normal[3] = {to.normal.x, to.normal.y, to.normal.z};
    pushed -= close;
    deepest = depth > deepest ? depth : deepest;
    for (int a = 0; a < 3; ++a) {
      float* p = x + i + a * n;
      const F old = load_few(p, count);
      store_few(p, close ? old + depth * normal[a] : old, count);
    }
  });
  Pushed all = {0, 0};
  for (int k = 0; k < kWide; ++k) all.count += pushed[k], all.depth = deepest[k] > all.depth ? deepest[k] : all.depth;
  return all;
}

void stop(const UpscaledBody& b, int n, const float* x, float* v, float reach) {
  touching(b, n, x, reach, [&](int i, int count, const Places& close, const Near& to) {
    const F m[3] = {to.normal.x, to.normal.y, to.normal.z}, u[3] = {to.velocity.x, to.velocity.y, to.velocity.z};
    F old[3], in = {};
    for (int a = 0; a < 3; ++a) old[a] = load_few(v + i + a * n, count), in += m[a] * (old[a] - u[a]);
    const Places enters = close & (in < 0.0f);
    if (!any<float>(enters)) return;
    for (int a = 0; a < 3; ++a) store_few(v + i + a * n, enters ? old[a] - in * m[a] : old[a], count);
  });
}

constexpr ProjectionLanes instance = {push, stop};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ProjectionLanes, instance)

}  // namespace minicloth
