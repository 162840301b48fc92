// When to look at close parts again. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>

#include "distance.hpp"
#include "near.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
void look(const T* x, const T* v, int width, const Sweep<T>& s, Close<T>* parts, const int* which, int count,
          bool edges, const Looking<T>& how, std::uint8_t* wait) {
  constexpr int n = kLanes<T>;
  const V<T> none = {}, one = none + T(1), most = none + T(kMostSteps);
  const T rate = 1 / how.h;
  for (int first = 0; first < count; first += n) {
    alignas(64) int at[4][n];
    alignas(64) T old[3][n], haste[n];
    for (int l = 0; l < n; ++l) {
      const Close<T>& part = parts[which[std::min(first + l, count - 1)]];
      for (int k = 0; k < 3; ++k) old[k][l] = part.side[k];
      for (int q = 0; q < 4; ++q) at[q][l] = part.at[q];
      haste[l] = s.pairs[part.owner].haste;
    }
    V3<T> p[4], w[4];
    for (int q = 0; q < 4; ++q) {
      p[q] = {gather<T>(x, at[q]), gather<T>(x + width, at[q]), gather<T>(x + 2 * width, at[q])};
      w[q] = {gather<T>(v, at[q]), gather<T>(v + width, at[q]), gather<T>(v + 2 * width, at[q])};
    }
    const Nearest<T> near = edges ? of_edges<T>(p[0], p[1], p[2], p[3]) : of_triangle<T>(p[0], p[1], p[2], p[3]);
    const V3<T> d = apart(near, p[0], p[1], p[2], p[3]), u = apart(near, w[0], w[1], w[2], w[3]);
    const V<T> d2 = dot(d, d) + tiny<T>, inverse = rsqrt(d2), far = d2 * inverse;
    const V3<T> before = {load(old[0]), load(old[1]), load(old[2])};
    const auto turned = (dot(d, before) < none) & (far < T(2) * how.reach);
    const V<T> way = turned ? -inverse : inverse;
    const V3<T> up = way * d;
    const V<T> un = dot(u, up), closing = un < none ? -un : none, room = far - how.danger;
    const V<T> u2 = dot(u, u) + tiny<T>;
    V<T> steps = (rate * room) / (u2 * rsqrt(u2) + load(haste));
    steps = (turned | (steps < one)) ? one : (steps > most ? most : steps);
    const V<T> gap = far - how.reach;
    const auto act = turned | (gap < closing * (how.h * steps));
    store<T>(old[0], up.x), store<T>(old[1], up.y), store<T>(old[2], up.z);
    for (int l = 0; l < n && first + l < count; ++l) {
      wait[first + l] = std::uint8_t(int(steps[l]) | (act[l] ? kAct : 0));
      for (int k = 0; k < 3; ++k) parts[which[first + l]].side[k] = old[k][l];
    }
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
