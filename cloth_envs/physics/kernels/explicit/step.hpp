// One substep of all vertices, in place. Included where it is compiled for an instruction set.
#pragma once
#include "keep_out.hpp"
#include "springs.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Every edge is evaluated once, at the vertex that it leaves towards column + 1, row + 1 or a diagonal, of which all
// are still where they were; then the vertex moves. Of a simple material f = k (1 - L / |d + damping w|) d: the dashpot
// lies in the length.
template <class T, bool kSimple, Part kPart>
void step(const Strips<T>& s, const Fields<T>& f, const StepTerms<T>& p, const std::vector<BodyLanes<T>>& bodies,
          const std::vector<Near>& near) {
  constexpr int n = kLanes<T>, q = 3 * n, w = 4 * n;
  const int cols = s.cols;
  const V<T> none = {};
  const V<T> stretch = load(p.stretch), shear = load(p.shear), damping = load(p.damping);
  const V<T> accelerate = load(p.accelerate), decay = load(p.decay), dt = load(p.dt);
  const Yielding<T> yielding = {load(p.yields), load(p.buckled), load(p.buckling), load(p.shortened_damping)};
  const std::ptrdiff_t to_x = f.x - f.y, to_v = f.v - f.y, to_slow = f.slow - f.y;
  T* const arrive = f.arrive;
  ghosts(s, f.x, 0, 1), ghosts(s, f.y, 0, 1);

  // What edges to d pull with, over d; e are the same of y.
  using Ways = V3<T>[4];
  using Springs = const Spring<T>* const[4];
  using Four = V<T>[4];
  const auto edges = [&](const Ways& d, const Ways& e, const Springs& springs, Four& p) __attribute__((always_inline)) {
    if constexpr (kSimple) {
      for (int i = 0; i < 4; ++i) p[i] = e[i].x * e[i].x + tiny<T>;
      for (int i = 0; i < 4; ++i) p[i] += e[i].y * e[i].y;
      for (int i = 0; i < 4; ++i) p[i] += e[i].z * e[i].z;
      pull(p, springs);
    } else {
      for (int i = 0; i < 4; ++i) {
        const Spring<T>& spring = *springs[i];
        p[i] = yielding_pull(d[i], e[i], spring.k, spring.length, yielding);
      }
    }
  };
  const auto move = [&](T* y, const V3<T>& x, const Pulls<T>& all, const V<T>& kick,
                        const V<T>& fall) __attribute__((always_inline)) {
    const V3<T> v = get<T>(y + to_v);
    const V3<T> force = (all.to - all.over * x) + get<T>(y + to_slow);
    const V3<T> u = {decay * v.x + kick * force.x, decay * v.y + kick * force.y, (decay * v.z - fall) + kick * force.z};
    set<T>(y + to_v, u);
    if constexpr (kPart == Part::kLast) return;
    const V3<T> x1 = {x.x + dt * u.x, x.y + dt * u.y, x.z + dt * u.z};
    set<T>(y + to_x, x1);
    set<T>(y, V3<T>{x1.x + damping * u.x, x1.y + damping * u.y, x1.z + damping * u.z});
  };

  for (int r = 0; r < s.rows; ++r) {
    const V<T> inverse_area = load(s.inverse_area.data() + r * n);
    const V<T> inner = accelerate * inverse_area, fall = load(p.gravity_kick) * load(s.inside.data() + r * n);
    const V<T> down_k = stretch * load(s.down.data() + r * n), shear_k = shear * load(s.shear.data() + r * n);
    const Spring<T> along(stretch * load(s.along.data() + r * n), s.col_length), down(down_k, s.row_length);
    const Spring<T> border(T(0.5) * down_k, s.row_length), diagonal(shear_k, s.diagonal), no(none, T(0));
    Pulls<T> east_before = {}, down_before = {}, right_before = {};
    T* const row = f.y + s.at(r, 0);

    const auto vertex = [&](int c, const Spring<T>& to_east, const Spring<T>& to_south, const Spring<T>& to_right,
                            const Spring<T>& to_left, const V<T>& kick) __attribute__((always_inline)) {
      T *const y0 = row + c * q, *const y1 = y0 + s.stride;
      const T* const ends[4] = {y0 + q, y1, y1 + q, y1 - q};
      const V3<T> at = get<T>(y0), x = get<T>(y0 + to_x);
      V3<T> d[4], e[4];
      V<T> p[4];
      for (int i = 0; i < 4; ++i) e[i] = get<T>(ends[i]) - at;
      if constexpr (!kSimple)
        for (int i = 0; i < 4; ++i) d[i] = get<T>(ends[i] + to_x) - x;
      edges(d, e, {&to_east, &to_south, &to_right, &to_left}, p);
      Pulls<T> all = east_before;
      for (int i = 0; i < 4; ++i) all = all + towards(p[i], get<T>(ends[i] + to_x));
      const Pulls<T> arrived = get_pulls<T>(arrive + c * w);
      set_pulls<T>(arrive + (c - 1) * w, down_before + towards(p[3], x));
      east_before = towards(p[0], x), down_before = right_before + towards(p[1], x), right_before = towards(p[2], x);
      if (r == 0)
        set_pulls<T>(f.first + c * w, all);
      else
        move(y0, x, all + arrived, kick, fall);
    };
    if (s.periodic) {
      T* const y0 = row - q;  // the edge that goes round
      const V3<T> d = get<T>(row + to_x) - get<T>(y0 + to_x), e = get<T>(row) - get<T>(y0);
      V<T> p[4];
      edges({d, d, d, d}, {e, e, e, e}, {&along, &along, &along, &along}, p);
      east_before = towards(p[0], get<T>(y0 + to_x));
      for (int c = 0; c < cols; ++c) vertex(c, along, down, diagonal, diagonal, inner);
      set_pulls<T>(arrive + (cols - 1) * w, down_before + get_pulls<T>(arrive - w));
      set_pulls<T>(arrive, get_pulls<T>(arrive) + right_before);
    } else {
      vertex(0, along, border, diagonal, no, T(2) * inner);
      for (int c = 1; c < cols - 1; ++c) vertex(c, along, down, diagonal, diagonal, inner);
      vertex(cols - 1, no, border, no, diagonal, T(2) * inner);
      set_pulls<T>(arrive + (cols - 1) * w, down_before);
    }
  }
  // The first row waited: what arrives there comes from the last row of the band before.
  const V<T> inner = accelerate * load(s.inverse_area.data()), fall = load(p.gravity_kick) * load(s.inside.data());
  for (int c = 0; c < cols; ++c) {
    T* const y0 = f.y + s.at(0, c);
    Pulls<T> all = get_pulls<T>(f.first + c * w);
    if (s.banded) all = all + earlier(get_pulls<T>(arrive + c * w));
    const bool border = !s.periodic && (c == 0 || c == cols - 1);
    move(y0, get<T>(y0 + to_x), all, border ? T(2) * inner : inner, fall);
  }
  if constexpr (kPart == Part::kBodies) keep_out(s, p, bodies, near, f.x, f.v, f.y);
  if constexpr (kPart == Part::kLast)
    if (!bodies.empty()) rest(s, f, p, bodies, near);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
