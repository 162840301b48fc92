// Which bodies blocks of columns may meet in the next substeps. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>

#include "keep_out.hpp"

namespace minicloth {
namespace LANES {
namespace {

constexpr int kColumns = 8;
constexpr double kMargin = 0.002;  // m, beyond what speeds ask for
constexpr double kWild = 0.01;     // m, in all steps

template <class T>
inline V<T> least(const V<T>& a, const V<T>& b) {
  return a < b ? a : b;
}
template <class T>
inline V<T> most(const V<T>& a, const V<T>& b) {
  return a > b ? a : b;
}

// The fastest component of velocities, of each cloth in lanes or of one in bands.
template <class T>
V<T> fastest(const Strips<T>& s, const T* v) {
  constexpr int q = 3 * kLanes<T>;
  V<T> high = {};
  for (int r = 0; r < s.rows; ++r)
    for (int i = 0; i < s.cols * q; i += kLanes<T>) {
      const V<T> one = load(v + s.at(r, 0) + i);
      high = most<T>(high, most<T>(one, -one));
    }
  for (int l = 0; s.banded && l < kLanes<T>; ++l) high = most<T>(high, V<T>{} + high[l]);
  return high;
}

// The vertices near bodies whose box of where they will be in the next `steps` meets the box of the vertices of some
// columns: nearer than what the fastest vertex and the fastest body, which may push it, go meanwhile, twice. All are
// near all in a single step, which may throw what begins inside a body anywhere, and where something goes over kWild.
template <class T>
void near(const Strips<T>& s, const Fields<T>& f, const StepTerms<T>& p, const std::vector<BodyLanes<T>>& bodies,
          int steps, std::vector<Near>& out) {
  constexpr int n = kLanes<T>;
  const std::vector<Moving<T>>& moving = moving_bodies(bodies, p);
  const V<T> none = {}, far = none + T(1e9);
  V<T> pushed = none;
  for (const BodyLanes<T>& body : bodies) pushed = most<T>(pushed, load(body.way));
  const V<T> way = T(steps) * load(p.dt) * fastest(s, f.v) + pushed, slack = T(2) * way + T(kMargin);
  const bool all = steps == 1 || any<T>(way > T(kWild));
  const auto there = [&](int r) { return load(s.inside.data() + r * n) > none; };
  out.clear();
  for (int r = 0; all && r < s.rows; ++r)
    for (int c = 0; c < s.cols; ++c) out.push_back({int(s.at(r, c)), bits<T>(there(r)), ~std::uint64_t(0)});
  thread_local std::vector<int> block;  // bodies near some columns
  for (int begin = 0; !all && begin < s.cols; begin += kColumns) {
    const int end = std::min(begin + kColumns, s.cols);
    V<T> low[3] = {far, far, far}, high[3] = {-far, -far, -far};
    for (int r = 0; r < s.rows; ++r)
      for (int c = begin; c < end; ++c)
        for (int k = 0; k < 3; ++k) {
          const V<T> x = load(f.x + s.at(r, c) + k * n);
          low[k] = least<T>(low[k], there(r) ? x : far), high[k] = most<T>(high[k], there(r) ? x : -far);
        }
    block.clear();
    for (std::size_t b = 0; b < bodies.size(); ++b) {
      const V<T> wide = slack + bodies[b].radius;
      auto meets = none <= none;
      for (int k = 0; bodies[b].shape != Shape::kPlane && k < 3; ++k)
        meets &= (load(bodies[b].low[k]) - wide < high[k]) & (low[k] < load(bodies[b].high[k]) + wide);
      if (any<T>(meets)) block.push_back(int(b));
    }
    if (block.empty()) continue;
    for (int r = 0; r < s.rows; ++r)
      for (int c = begin; c < end; ++c) {
        const V3<T> x = get<T>(f.x + s.at(r, c));
        Near found = {int(s.at(r, c)), 0, 0};
        for (const int b : block) {
          const V<T> wide = moving[b].radius + slack;
          const unsigned lanes = bits<T>((distance2(moving[b], x) < wide * wide) & there(r));
          found.lanes |= lanes, found.bodies |= std::uint64_t(lanes > 0) << b % kBits;
        }
        if (found.lanes) out.push_back(found);
      }
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
