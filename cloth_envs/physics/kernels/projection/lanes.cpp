// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <cstring>
#include <limits>

#include "../base/simd.hpp"
#include "../sheet/contact.hpp"
#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;
constexpr int kRun = 32;           // vertices
constexpr float kRounded = 1e-4f;  // m, more than rounding makes of a distance

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

// The box of `count` vertices or fewer of a plane of n, lane by lane; NaN is nowhere.
struct Box {
  F low[3], high[3];
};
Box box(const float* x, int n, int count) {
  const F far = F{} + std::numeric_limits<float>::max();
  Box all = {{far, far, far}, {-far, -far, -far}};
  for (int i = 0; i < count; i += kWide)
    for (int k = 0; k < 3; ++k) {
      const F at = load_few(x + k * n + i, std::min(count - i, kWide));
      all.low[k] = at < all.low[k] ? at : all.low[k], all.high[k] = at > all.high[k] ? at : all.high[k];
    }
  return all;
}

// Whether some of it may be less than `reach` off a body's surface.
bool meets(const Box& vertices, const UpscaledBody& b, float reach) {
  if (b.plane) return true;
  const float outer = b.radius + reach + kRounded;
  Places meet = F{} <= F{};
  for (int k = 0; k < 3; ++k) {
    const auto [low, high] = std::minmax(b.ends[0][k], b.ends[1][k]);
    meet &= (vertices.low[k] < high + outer) & (vertices.high[k] > low - outer);
  }
  return any<float>(meet);
}

// Calls each(first vertex, lanes, which of them, what is near them) where the gap of some of `count` vertices of a
// plane of n is less than `reach`.
template <class Each>
void touching(const UpscaledBody& b, int n, int count, const float* x, float reach, const Each& each) {
  const float outer = b.radius + reach, limit = outer * outer;
  const V3<float> point = axis_point<float>(b.ends, F{}), normal = axis_point<float>(b.ends, F{} + 1.0f);
  const bool ball = !b.plane && std::memcmp(b.ends[0], b.ends[1], sizeof b.ends[0]) == 0;
  Places lane;
  for (int k = 0; k < kWide; ++k) lane[k] = k;
  for (int i = 0; i < count; i += kWide) {
    const int few = std::min(count - i, kWide);
    const V3<float> at = {load_few(x + i, few), load_few(x + i + n, few), load_few(x + i + 2 * n, few)};
    const V3<float> d = at - point;  // a quick test of most vertices, which are far
    if (b.plane ? !any<float>(dot(normal, d) < outer) : ball && !any<float>(dot(d, d) < limit)) continue;
    const Near to = near(b, at);
    const Places close = (to.gap < reach) & (lane < few);
    if (any<float>(close)) each(i, few, close, to);
  }
}

// Calls each(first vertex, how many, their box) for runs of n vertices.
template <class Each>
void runs(int n, const float* x, const Each& each) {
  for (int i = 0; i < n; i += kRun) {
    const int count = std::min(n - i, kRun);
    each(i, count, box(x + i, n, count));
  }
}

Pushed push(const std::vector<UpscaledBody>& bodies, int n, float* x) {
  Places pushed = {};
  F deepest = {};
  runs(n, x, [&](int first, int count, Box vertices) {
    Places were = pushed;
    for (int pass = 0; pass < (bodies.size() > 1 ? 2 : 1); ++pass) {
      for (const UpscaledBody& b : bodies) {
        if (!meets(vertices, b, 0.0f)) continue;
        bool moved = false;
        touching(b, n, count, x + first, 0.0f, [&](int i, int few, const Places& close, const Near& to) {
          const F depth = close ? -to.gap : F{}, normal[3] = {to.normal.x, to.normal.y, to.normal.z};
          if (pass == 0) pushed -= close, deepest = depth > deepest ? depth : deepest;
          for (int a = 0; a < 3; ++a) {
            float* p = x + first + i + a * n;
            const F old = load_few(p, few);
            store_few(p, close ? old + depth * normal[a] : old, few);
          }
          moved = true;
        });
        if (moved) vertices = box(x + first, n, count);
      }
      if (!any<float>(pushed != were)) break;  // nobody was inside
    }
  });
  Pushed all = {0, 0};
  for (int k = 0; k < kWide; ++k) all.count += pushed[k], all.depth = deepest[k] > all.depth ? deepest[k] : all.depth;
  return all;
}

void stop(const std::vector<UpscaledBody>& bodies, int n, const float* x, float* v, float reach) {
  runs(n, x, [&](int first, int count, const Box& vertices) {
    for (const UpscaledBody& b : bodies) {
      if (!meets(vertices, b, reach)) continue;
      touching(b, n, count, x + first, reach, [&](int i, int few, const Places& close, const Near& to) {
        const F m[3] = {to.normal.x, to.normal.y, to.normal.z}, u[3] = {to.velocity.x, to.velocity.y, to.velocity.z};
        float* const p = v + first + i;
        F old[3], in = {};
        for (int a = 0; a < 3; ++a) old[a] = load_few(p + a * n, few), in += m[a] * (old[a] - u[a]);
        const Places enters = close & (in < 0.0f);
        if (!any<float>(enters)) return;
        for (int a = 0; a < 3; ++a) store_few(p + a * n, enters ? old[a] - in * m[a] : old[a], few);
      });
    }
  });
}

constexpr ProjectionLanes instance = {push, stop};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ProjectionLanes, instance)

}  // namespace minicloth
