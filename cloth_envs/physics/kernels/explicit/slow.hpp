// Bending and the air, forces that change slowly. Included where it is compiled for an instruction set.
#pragma once
#include "../sheet/air.hpp"
#include "core.hpp"
#include "springs.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Bending in row r (Bergou et al. 2006): the second differences along rows and columns and the mixed one of cells.
template <class T>
struct Bending {
  V<T> along, above, here, below;  // weights of second differences along this row, and down in the middle of each
  V<T> cell_above, cell;           // of mixed differences
  V3<T> before = {}, now = {}, twist = {}, twist_above = {};  // second differences at c - 1, c; mixed ones of c - 1

  Bending(const Strips<T>& s, const V<T>& twist, int r) {
    constexpr int n = kLanes<T>;
    const V<T> none = {};
    const auto row = [&](const Plane<T>& weights, int i) {
      if (i < 0) return s.banded ? late(none, load(weights.data() + (s.rows - 1) * n)) : none;
      if (i == s.rows) return s.banded ? early(load(weights.data())) : none;
      return load(weights.data() + i * n);
    };
    along = row(s.bend_along, r), above = row(s.bend_down, r - 1), here = row(s.bend_down, r);
    below = row(s.bend_down, r + 1), cell_above = twist * row(s.cell, r - 1), cell = twist * row(s.cell, r);
  }
  // a - 2 b + c, and twice the middle less both others.
  static V3<T> second(const V3<T>& a, const V3<T>& b, const V3<T>& c) {
    return {(a.x + c.x) - T(2) * b.x, (a.y + c.y) - T(2) * b.y, (a.z + c.z) - T(2) * b.z};
  }
  static V3<T> bulge(const V3<T>& a, const V3<T>& b, const V3<T>& c) {
    return {T(2) * b.x - (a.x + c.x), T(2) * b.y - (a.y + c.y), T(2) * b.z - (a.z + c.z)};
  }
  static V3<T> mixed(const V3<T>& a, const V3<T>& b, const V3<T>& c, const V3<T>& d) { return (a - b) - (c - d); }
};

// The coefficients of air_force in every lane.
template <class T>
struct Blow {
  V<T> normal, lift, tangential;
};

// Forces on the corners of each cell, as in sheet/air.hpp: of the air, of pressure or of both.
template <class T, bool kAir, bool kPressure>
void slow_air(const Strips<T>& s, const Fields<T>& f, const SlowTerms<T>& p) {
  constexpr int n = kLanes<T>, q = 3 * n, w = 4 * n;
  const V<T> normal = load(p.normal), lift = load(p.lift), tangential = load(p.tangential);
  const V3<T> wind = {T(4) * load(p.wind[0]), T(4) * load(p.wind[1]), T(4) * load(p.wind[2])};
  const int cells = s.periodic ? s.cols : s.cols - 1;
  std::fill_n(f.low - w, (s.cols + 2) * w, T(0));
  const auto add = [&](int r, int c, const Pulls<T>& all) __attribute__((always_inline)) {
    T* const to = f.slow + s.at(r, c);
    V3<T> force = get<T>(to) + all.to;
    if constexpr (kAir) force = force - all.over * get<T>(f.mid + s.at(r, c));
    set<T>(to, force);
  };
  for (int r = 0; r < s.rows; ++r) {
    const V<T> share = load(s.cell.data() + r * n), pressure = share * load(p.pressure);
    const Blow<T> blow = {share * normal, share * lift, share * tangential};
    const T *const x = f.ahead + s.at(r, 0), *const v = f.mid + s.at(r, 0);
    Pulls<T> upper_before = {}, lower_before = {};  // on the right corners of the cell before
    const auto put_corners = [&](int c, const Pulls<T>& upper, const Pulls<T>& lower) __attribute__((always_inline)) {
      add(r, c, upper), add(r, c, get_pulls<T>(f.low + c * w));
      set_pulls<T>(f.low + c * w, lower);
    };
    V3<T> at = get<T>(x), below = get<T>(x + s.stride), pair = {};
    if constexpr (kAir) pair = get<T>(v) + get<T>(v + s.stride);
    for (int c = 0; c < cells; ++c) {
      const V3<T> beside = get<T>(x + (c + 1) * q), across = get<T>(x + s.stride + (c + 1) * q);
      const V3<T> area = cross(across - at, beside - below);  // twice
      Pulls<T> corner[4] = {};
      if constexpr (kAir) {
        const V3<T> next = get<T>(v + (c + 1) * q) + get<T>(v + s.stride + (c + 1) * q);
        const Blown<T> blown = air_force(area, pair + next, wind, blow);
        for (int k = 0; k < 4; ++k) corner[k] = {blown.to, blown.over};
        pair = next;
      }
      if constexpr (kPressure) {
        const Pressed<T> pressed(beside - at, across - at, below - at, area);
        for (int k = 0; k < 4; ++k) corner[k].to = corner[k].to + pressure * pressed.corner[k];
      }
      put_corners(c, upper_before + corner[0], lower_before + corner[3]);
      upper_before = corner[1], lower_before = corner[2];
      at = beside, below = across;
    }
    if (s.periodic) {
      add(r, 0, upper_before), set_pulls<T>(f.low, get_pulls<T>(f.low) + lower_before);
    } else {
      put_corners(cells, upper_before, lower_before);
    }
  }
  for (int c = 0; s.banded && c < s.cols; ++c) add(0, c, earlier(get_pulls<T>(f.low + c * w)));
}

template <class T>
void slow_bending(const Strips<T>& s, const Fields<T>& f, const SlowTerms<T>& p) {
  constexpr int n = kLanes<T>, q = 3 * n;
  const V<T> stiffness = load(p.bend), twist = load(p.twist) * s.twist;
  const int cols = s.cols;
  for (int r = 0; r < s.rows; ++r) {
    Bending<T> b(s, twist, r);
    const T* const row = f.ahead + s.at(r, 0);
    const auto x = [&](int down, int c)
                       __attribute__((always_inline)) { return get<T>(row + down * s.stride + c * q); };
    V3<T> here = x(0, 0), right = x(0, 1), up = x(-1, 0), down = x(1, 0);
    if (s.periodic) {
      const V3<T> left = x(0, -1);
      b.before = b.along * b.second(x(0, -2), left, here), b.now = b.along * b.second(left, here, right);
      b.twist = b.cell * b.mixed(left, here, x(1, -1), down);
      b.twist_above = b.cell_above * b.mixed(x(-1, -1), up, left, here);
    }
    const auto vertex = [&](int c, T column, bool next, bool inner) __attribute__((always_inline)) {
      const V3<T> far = x(0, c + 2), up_right = x(-1, c + 1), down_right = x(1, c + 1);
      const V3<T> none = {};
      const V3<T> after = inner ? b.along * b.second(here, right, far) : none;
      const V3<T> twist = next ? b.cell * b.mixed(here, right, down, down_right) : none;
      const V3<T> twist_above = next ? b.cell_above * b.mixed(up, up_right, here, right) : none;
      const V3<T> above = b.above * b.second(x(-2, c), up, here), middle = b.here * b.second(up, here, down);
      const V3<T> below = b.below * b.second(here, down, x(2, c));
      const V<T> part = V<T>{} + column;
      const V3<T> force = b.bulge(b.before, b.now, after) + part * b.bulge(above, middle, below) +
                          ((b.twist - twist) + (twist_above - b.twist_above));
      set<T>(f.slow + s.at(r, c), stiffness * force);
      b.before = b.now, b.now = after, b.twist = twist, b.twist_above = twist_above;
      here = right, right = far, up = up_right, down = down_right;
    };
    if (s.periodic) {
      for (int c = 0; c < cols; ++c) vertex(c, T(1), true, true);
    } else {
      vertex(0, T(0.5), true, true);
      for (int c = 1; c < cols - 2; ++c) vertex(c, T(1), true, true);
      vertex(cols - 2, T(1), true, false);
      vertex(cols - 1, T(0.5), false, false);
    }
  }
}

// The forces in the middle of the time for which they are held, as positions and velocities let expect it.
template <class T, bool kBend, bool kAir, bool kPressure>
void slow(const Strips<T>& s, const Fields<T>& f, const SlowTerms<T>& p) {
  constexpr int q = 3 * kLanes<T>;
  const V<T> later = load(p.later), trend = V<T>{} + p.trend;
  for (int r = 0; r < s.rows; ++r)
    for (std::ptrdiff_t i = s.at(r, 0); i < s.at(r, s.cols); i += q) {
      const V3<T> v = get<T>(f.v + i);
      set<T>(f.ahead + i, get<T>(f.x + i) + later * v);
      if constexpr (kAir) {
        set<T>(f.mid + i, v + trend * (v - get<T>(f.past + i)));
        set<T>(f.past + i, v);
      }
    }
  ghosts(s, f.ahead, kBend ? 2 : 0, kBend ? 2 : 1);
  if constexpr (kAir) ghosts(s, f.mid, 0, 1);
  if constexpr (kBend)
    slow_bending(s, f, p);
  else
    for (int r = 0; r < s.rows; ++r) std::fill_n(f.slow + s.at(r, 0), s.cols * q, T(0));
  if constexpr (kAir || kPressure) slow_air<T, kAir, kPressure>(s, f, p);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
