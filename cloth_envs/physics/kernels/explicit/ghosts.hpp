// Loads and stores of Strips, and what lies around its rows and columns.
#pragma once
#include "../base/simd.hpp"
#include "strips.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
inline V3<T> get(const T* p) {
  constexpr int n = kLanes<T>;
  return {load(p), load(p + n), load(p + 2 * n)};
}
template <class T>
inline void set(T* p, const V3<T>& v) {
  constexpr int n = kLanes<T>;
  store<T>(p, v.x), store<T>(p + n, v.y), store<T>(p + 2 * n, v.z);
}

// What the band before has here, nothing before the first; and the band after.
template <class T>
inline V3<T> earlier(const V3<T>& v) {
  const V<T> none = {};
  return {late(none, v.x), late(none, v.y), late(none, v.z)};
}
template <class T>
inline V3<T> later(const V3<T>& v) {
  return {early(v.x), early(v.y), early(v.z)};
}

// Fills `above` rows before the bands' first and `below` after their last, and the columns beside those of a tube.
template <class T>
void ghosts(const Strips<T>& s, T* field, int above, int below) {
  constexpr int q = 3 * kLanes<T>;
  if (s.periodic)
    for (int r = 0; r < s.rows; ++r) {
      T *const row = field + s.at(r, 0), *const end = row + s.cols * q;
      for (int k = 0; k < kGhost; ++k) {
        set<T>(row - (k + 1) * q, get<T>(end - (k + 1) * q));
        set<T>(end + k * q, get<T>(row + k * q));
      }
    }
  if (!s.banded) return;
  const int first = s.periodic ? -kGhost : 0, last = s.periodic ? s.cols + kGhost : s.cols;
  for (int k = 0; k < below; ++k)
    for (int c = first; c < last; ++c) set<T>(field + s.at(s.rows + k, c), later(get<T>(field + s.at(k, c))));
  for (int k = 1; k <= above; ++k)
    for (int c = first; c < last; ++c) set<T>(field + s.at(-k, c), earlier(get<T>(field + s.at(s.rows - k, c))));
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
