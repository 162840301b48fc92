// Compiled once per instruction set; LANES names the namespace.
#include "../base/simd.hpp"
#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

using Range = Waves::Range;
template <class T>
using Lanes = decltype(V<T>{} < V<T>{});  // whole numbers as wide as a T, and masks of them

static_assert(Waves::kGhosts >= kLanes<float>, "a vector that begins at a wave's last particle would leave the wave");

// Of the lanes from row r on, which lie in the range.
template <class T>
inline Lanes<T> within(int r, const Range& range) {
  Lanes<T> row;
  for (int k = 0; k < kLanes<T>; ++k) row[k] = k;
  return (row >= range.first - r) & (row < range.last - r);
}

// Calls with (r, i) for vectors of particles from row r on, at i in planes; the last of a wave reaches into ghosts.
template <class T, class Call>
inline void in_wave(const Waves& waves, int wave, const Range& own, const Call& call) {
  const int i = waves.at(0, wave);
  for (int r = own.first; r < own.last; r += kLanes<T>) call(r, i + r);
}
template <class T, class Call>
inline void everywhere(const Waves& waves, const Call& call) {
  for (int wave = 0; wave < waves.count(); ++wave) in_wave<T>(waves, wave, waves.with(wave, 0, 0), call);
}

// A neighbour's position, or the particle's own where there is none.
template <class T>
inline V3<T> beside(const Waves& waves, int wave, int r, int i, int down, int right, Axes<T> x, const V3<T>& own) {
  const V3<T> a = at<T>(x, i + waves.shift(down, right));
  const Lanes<T> there = within<T>(r, waves.with(wave, down, right));
  return {there ? a.x : own.x, there ? a.y : own.y, there ? a.z : own.z};
}

// Pressure (eq. 3): p times the sum of r_a x r_b over the four pairs of nearest neighbours, counter-clockwise seen
// from the side it pushes to. The sum is (right - left) x (up - down); where a neighbour is missing, so is what it
// would have added, as if it lay on the particle.
template <class T>
inline V3<T> pressed(const NetStep<T>& s, int wave, int r, int i, Axes<T> x, const V3<T>& own) {
  const auto to = [&](int down, int right) { return beside<T>(s.waves, wave, r, i, down, right, x, own); };
  return (V<T>{} + s.pressure) * cross(to(0, 1) - to(0, -1), to(-1, 0) - to(1, 0));
}

// The sum over links of F = alpha d + beta n + gamma (w . n) n, n = d / sqrt(|d|^2 + eps); d and w are the neighbour's
// position and velocity less the particle's own. `inside`: all lanes have all neighbours.
template <bool inside, class T>
inline V3<T> linked(const NetStep<T>& s, const Range* near, int r, int i, Axes<T> x, Axes<T> v, const V3<T>& own,
                    const V3<T>& speed) {
  V3<T> f = {};
  for (int n = 0; n < s.count; ++n) {
    const Link<T>& link = s.links[n];
    const V3<T> d = at<T>(x, i + link.shift) - own, w = at<T>(v, i + link.shift) - speed;
    const V<T> inverse = rsqrt(dot(d, d) + s.eps);
    V<T> scale = link.alpha + inverse * (link.beta + link.gamma * inverse * dot(d, w));
    if (!inside) scale = within<T>(r, near[n]) ? scale : V<T>{};
    f = f + scale * d;
  }
  return f;
}

template <class T>
void velocities(const NetStep<T>& s, Axes<T> x, Axes<T> v, Axes<T> out) {
  const V3<T> weight = {V<T>{} + s.weight[0], V<T>{} + s.weight[1], V<T>{} + s.weight[2]};
  everywhere<T>(s.waves, [&](int, int i) { put<T>(v, i, at<T>(v, i) + weight); });
  for (int wave = 0; wave < s.waves.count(); ++wave) {
    Range near[kMostNeighbours], all = s.waves.with(wave, 0, 0);
    const Range own = all;
    for (int n = 0; n < s.count; ++n) {
      near[n] = s.waves.with(wave, s.links[n].down, s.links[n].right);
      all = {std::max(all.first, near[n].first), std::min(all.last, near[n].last)};
    }
    in_wave<T>(s.waves, wave, own, [&](int r, int i) {
      const V3<T> at_rest = at<T>(x, i), speed = at<T>(v, i);
      V3<T> f = r >= all.first && r + kLanes<T> <= all.last ? linked<true, T>(s, near, r, i, x, v, at_rest, speed)
                                                            : linked<false, T>(s, near, r, i, x, v, at_rest, speed);
      if (s.pressure != 0) f = f + pressed<T>(s, wave, r, i, x, at_rest);
      put<T>(out, i, speed + (V<T>{} + s.kick) * f);
    });
  }
}

template <class T>
inline V3<T> hit(const NetBall<T>& b, const V3<T>& x, const V3<T>& v) {
  const V3<T> moving = {V<T>{} + b.velocity[0], V<T>{} + b.velocity[1], V<T>{} + b.velocity[2]};
  const V3<T> d = {x.x - b.centre[0], x.y - b.centre[1], x.z - b.centre[2]}, u = v - moving;
  const V<T> away = dot(d, d), along = dot(d, u), none = {};
  const auto inside = (away < b.radius * b.radius) & (away > T(0));
  const V<T> inwards = (along < T(0)) & inside ? along / away : none;
  const V3<T> left = moving + (V<T>{} + b.keep) * (u - inwards * d);
  return {inside ? left.x : v.x, inside ? left.y : v.y, inside ? left.z : v.z};
}

template <class T>
void move(const NetStep<T>& s, const std::vector<NetBall<T>>& balls, Axes<T> x, Axes<T> v) {
  everywhere<T>(s.waves, [&](int, int i) {
    const V3<T> before = at<T>(x, i);
    V3<T> speed = (V<T>{} + s.decay) * at<T>(v, i);
    for (const NetBall<T>& ball : balls) speed = hit(ball, before, speed);
    put<T>(v, i, speed), put<T>(x, i, before + (V<T>{} + s.dt) * speed);
  });
}

template <class T>
const NetLanes<T> table = {velocities<T>, move<T>};

}  // namespace
}  // namespace LANES
DEFINE_LANES(NetLanes<float>, table<float>)
DEFINE_LANES(NetLanes<double>, table<double>)

}  // namespace minicloth
