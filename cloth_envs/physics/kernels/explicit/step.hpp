// One substep of all vertices, in place. Included where it is compiled for an instruction set.
#pragma once
#include "ghosts.hpp"

namespace minicloth {
namespace LANES {
namespace {

// A spring's k, and L k times the numbers of rsqrt's Newton step.
template <class T>
struct Spring {
  V<T> k, half, most, length;
  Spring(const V<T>& k_, T length_)
      : k(k_), half((T(0.5) * length_) * k_), most((T(1.5) * length_) * k_), length(V<T>{} + length_) {}
};

// k (1 - L / sqrt(square)).
inline V<float> pull(const V<float>& square, const Spring<float>& s) {
  const V<float> e = rsqrt_estimate(square);
  return (((square * e) * e) * s.half - s.most) * e + s.k;
}
inline V<double> pull(const V<double>& square, const Spring<double>& s) {
  return s.k - s.k * (s.length * rsqrt(square));
}

template <class T>
inline V<T> square(const V3<T>& d) {
  return d.x * d.x + (d.y * d.y + (d.z * d.z + tiny<T>));
}

// Every edge is evaluated once, at the vertex that it leaves towards column + 1, row + 1 or a diagonal, of which all are
// still where they were; then the vertex moves. f = k (1 - L / |d + damping w|) d: the dashpot lies in the length.
template <class T, bool kYields, bool kImpulses, bool kBodies>
void step(const Strips<T>& s, const Fields<T>& f, const StepTerms<T>& p, const std::vector<BodyLanes<T>>& bodies) {
  constexpr int n = kLanes<T>, q = 3 * n;
  const int cols = s.cols;
  const V<T> none = {};
  const V<T> stretch = load(p.stretch), shear = load(p.shear), damping = load(p.damping);
  const V<T> accelerate = load(p.accelerate), decay = load(p.decay), dt = load(p.dt);
  const V<T> yields = load(p.yields), buckled = load(p.buckled), buckling = load(p.buckling);
  const V<T> shortened_damping = load(p.shortened_damping);
  const std::ptrdiff_t to_x = f.x - f.y, to_v = f.v - f.y, to_impulse = f.impulse - f.y;
  T* const arrive = f.arrive;
  ghosts(s, f.x, 0, 1), ghosts(s, f.y, 0, 1);

  // What an edge to d pulls with, over d; e is the same of y.
  const auto edge = [&](const V3<T>& d, const V3<T>& e, const Spring<T>& spring) __attribute__((always_inline)) {
    if constexpr (kYields) {
      const V<T> ratio = spring.length * rsqrt(square<T>(d)), extra = T(1) - ratio;
      const V<T> shorter = extra < T(0) ? extra : none, limit = -buckling * ratio;
      const V<T> rate = extra < T(0) ? shortened_damping : none + T(1);
      const V<T> damped = ratio - spring.length * rsqrt(square<T>(e));
      return spring.k * (extra + yields * shorter + buckled * (shorter > limit ? shorter : limit) + rate * damped);
    } else {
      return pull(square<T>(e), spring);
    }
  };
  const auto move = [&](T* y, const V3<T>& x, V3<T> force, const V<T>& kick, const V<T>& fall)
                        __attribute__((always_inline)) {
    const V3<T> v = get<T>(y + to_v);
    if constexpr (kImpulses) force = force + get<T>(y + to_impulse);
    V3<T> u = {decay * v.x + kick * force.x, decay * v.y + kick * force.y, (decay * v.z - fall) + kick * force.z};
    V3<T> x1 = {x.x + dt * u.x, x.y + dt * u.y, x.z + dt * u.z};
    if constexpr (kBodies)
      for (const BodyLanes<T>& body : bodies) touch(body, dt, x, x1, u);
    set<T>(y + to_v, u), set<T>(y + to_x, x1);
    set<T>(y, V3<T>{x1.x + damping * u.x, x1.y + damping * u.y, x1.z + damping * u.z});
  };

  for (int r = 0; r < s.rows; ++r) {
    const V<T> inverse_area = load(s.inverse_area.data() + r * n);
    const V<T> inner = accelerate * inverse_area, fall = load(p.gravity_kick) * load(s.inside.data() + r * n);
    const V<T> down_k = stretch * load(s.down.data() + r * n), shear_k = shear * load(s.shear.data() + r * n);
    const Spring<T> along(stretch * load(s.along.data() + r * n), s.col_length), down(down_k, s.row_length);
    const Spring<T> border(T(0.5) * down_k, s.row_length), diagonal(shear_k, s.diagonal), no(none, T(0));
    V3<T> east_before = {}, down_before = {}, right_before = {};
    T* const row = f.y + s.at(r, 0);

    const auto vertex = [&](int c, const Spring<T>& to_east, const Spring<T>& to_south, const Spring<T>& to_right,
                            const Spring<T>& to_left, const V<T>& kick) __attribute__((always_inline)) {
      T *const y0 = row + c * q, *const y1 = y0 + s.stride;
      const V3<T> at = get<T>(y0), x = get<T>(y0 + to_x);
      const V3<T> d0 = get<T>(y0 + q + to_x) - x, d1 = get<T>(y1 + to_x) - x, d2 = get<T>(y1 + q + to_x) - x,
                  d3 = get<T>(y1 - q + to_x) - x;
      const V<T> p0 = edge(d0, get<T>(y0 + q) - at, to_east), p1 = edge(d1, get<T>(y1) - at, to_south),
                 p2 = edge(d2, get<T>(y1 + q) - at, to_right), p3 = edge(d3, get<T>(y1 - q) - at, to_left);
      const V3<T> east = p0 * d0, south = p1 * d1, right = p2 * d2, left = p3 * d3;
      const V3<T> force = ((east - east_before) + left) + (south + right);
      const V3<T> arrived = get<T>(arrive + c * q);
      set<T>(arrive + (c - 1) * q, down_before + left);
      east_before = east, down_before = right_before + south, right_before = right;
      if (r == 0)
        set<T>(f.first + c * q, force);
      else
        move(y0, x, force - arrived, kick, fall);
    };
    if (s.periodic) {
      T* const y0 = row - q;  // the edge that goes round
      const V3<T> d = get<T>(row + to_x) - get<T>(y0 + to_x);
      east_before = edge(d, get<T>(row) - get<T>(y0), along) * d;
      for (int c = 0; c < cols; ++c) vertex(c, along, down, diagonal, diagonal, inner);
      set<T>(arrive + (cols - 1) * q, down_before + get<T>(arrive - q));
      set<T>(arrive, get<T>(arrive) + right_before);
    } else {
      vertex(0, along, border, diagonal, no, T(2) * inner);
      for (int c = 1; c < cols - 1; ++c) vertex(c, along, down, diagonal, diagonal, inner);
      vertex(cols - 1, no, border, no, diagonal, T(2) * inner);
      set<T>(arrive + (cols - 1) * q, down_before);
    }
  }
  // The first row waited: what arrives there comes from the last row of the band before.
  const V<T> inner = accelerate * load(s.inverse_area.data()), fall = load(p.gravity_kick) * load(s.inside.data());
  for (int c = 0; c < cols; ++c) {
    T* const y0 = f.y + s.at(0, c);
    V3<T> force = get<T>(f.first + c * q);
    if (s.banded) force = force - earlier(get<T>(arrive + c * q));
    const bool border = !s.periodic && (c == 0 || c == cols - 1);
    move(y0, get<T>(y0 + to_x), force, border ? T(2) * inner : inner, fall);
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
