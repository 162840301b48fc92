// Edges through triangles, and the contours that they make.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "contours.hpp"
#include "crossing.hpp"

namespace minicloth {
namespace {

constexpr double kStraight = 0.2;  // how much a contour turns at an edge that shortens it at full speed

int root(std::vector<int>& group, int i) {
  while (group[i] != i) i = group[i] = group[group[i]];
  return i;
}
void unite(std::vector<int>& group, int i, int j) {
  i = root(group, i), j = root(group, j);
  group[std::max(i, j)] = std::min(i, j);
}

}  // namespace

void Contours::shape(int rows, int cols, bool periodic) {
  if (rows == rows_ && cols == cols_ && periodic == periodic_) return;
  rows_ = rows, cols_ = cols, periodic_ = periodic;
  const std::size_t n = std::size_t(rows) * cols;
  at_.resize(n), cut_.assign(3 * n, 0), region_.assign(n, 0), pocket_.assign(n, 0), first_.assign(n + 1, 0);
  triangles_.assign(2 * n, {-1, -1, -1});
  for (int v = 0; v < (rows - 1) * cols; ++v)
    if (const int r = right(v); r >= 0)
      triangles_[2 * v] = {v, v + cols, r + cols}, triangles_[2 * v + 1] = {v, r + cols, r};
}

template <class T>
const std::vector<Hit>& Contours::find(const T* x, std::size_t plane, const std::vector<MeetingCells>& cells) {
  hits_.clear(), links_.clear(), pairs_ = 0;
  const auto get = [&](int v) { at_[v] = {double(x[v]), double(x[plane + v]), double(x[2 * plane + v])}; };
  for (const auto& [first, second, triangles] : cells) {
    if (!exists(first) || !exists(second)) continue;
    for (const int cell : {first, second})
      for (const int t : {2 * cell, 2 * cell + 1})
        for (const int v : triangle(t)) get(v);
    for (int k = 0; k < 4; ++k)
      if (triangles >> k & 1) test(2 * first + k / 2, 2 * second + k % 2);
  }
  if (hits_.empty()) return hits_;
  join(), ends(), shorten(), regions(), mark();
  return hits_;
}

// Two triangles without a common vertex; where two edges go through, they are the ends of a piece of a contour.
void Contours::test(int a, int b) {
  for (const int v : triangle(a))
    for (const int w : triangle(b))
      if (v == w) return;
  const int before = int(hits_.size());
  if (hit(a, b)) hit(b, a);
  const int found = int(hits_.size()) - before;
  pairs_ += found > 0;
  if (found == 2) links_.push_back({{before, before + 1}});
}

// Edges of a triangle through another one; whether it has corners on either side of that.
bool Contours::hit(int i, int other) {
  const std::array<int, 3>&t = triangle(i), &f = triangle(other);
  const Vec<double>&a = at_[f[0]], &b = at_[f[1]], &c = at_[f[2]], n = cross(b - a, c - a);
  const int kinds[2][3] = {{1, 0, 2}, {2, 1, 0}};
  double from[3];
  if (!minicloth::sides({at_[t[0]], at_[t[1]], at_[t[2]]}, a, n, from)) return false;
  for (int k = 0; k < 3; ++k) {
    const int next = (k + 1) % 3, p = t[k], q = t[next];
    const double d = from[k], e = from[next];
    if (!((d < 0 && e > 0) || (d > 0 && e < 0))) continue;
    if (!inside(at_[p], at_[q], {a, b, c})) continue;
    const bool forth = i % 2 ? k == 0 : k != 2;  // from the edge's first vertex
    const int edge = 3 * (forth ? p : q) + kinds[i % 2][k];
    hits_.push_back(
        {{p, q, f[0], f[1], f[2]}, edge, i, other, 0, -1, at_[p] + (d / (d - e)) * (at_[q] - at_[p]), {0, 0, 0}});
  }
  return true;
}

// The two triangles beside an edge have its hits in common; pieces of a contour meet there.
void Contours::join() {
  const int count = int(hits_.size());
  std::vector<int> merged(count);
  order_.resize(count), std::iota(order_.begin(), order_.end(), 0);
  std::sort(order_.begin(), order_.end(), [&](int i, int j) {
    const Hit &a = hits_[i], &b = hits_[j];
    return a.edge != b.edge ? a.edge < b.edge : a.triangle != b.triangle ? a.triangle < b.triangle : a.own < b.own;
  });
  std::vector<Hit> one_each;
  for (const int i : order_) {
    const Hit& h = hits_[i];
    if (one_each.empty() || one_each.back().edge != h.edge || one_each.back().triangle != h.triangle)
      one_each.push_back(h);
    merged[i] = int(one_each.size()) - 1;
  }
  hits_.swap(one_each);
  group_.resize(hits_.size()), joined_.assign(hits_.size(), {});
  std::iota(group_.begin(), group_.end(), 0);
  for (int l = 0; l < int(links_.size()); ++l) {
    for (int& i : links_[l].hits) i = merged[i], joined_[i].push_back(l);
    unite(group_, links_[l].hits[0], links_[l].hits[1]);
  }
}

// The triangle on the other side of a hit's edge, -1 at a border.
int Contours::across(const Hit& h) const {
  const int v = h.edge / 3, kind = h.edge % 3;
  const auto of = [&](int cell, int upper) { return cell < 0 || !exists(cell) ? -1 : 2 * cell + upper; };
  const int one = of(v, kind == 0), two = kind == 0 ? of(v - cols_, 0) : kind == 1 ? of(left(v), 1) : of(v, 1);
  return one == h.own ? two : one;
}

// Contours end at borders, or at a vertex where the sheet begins to cross itself: those that do so at one vertex belong
// together.
void Contours::ends() {
  stop_.assign(hits_.size(), -2);
  std::fill(region_.begin(), region_.end(), -1);
  for (int i = 0; i < int(hits_.size()); ++i) {
    if (joined_[i].size() > 1) continue;
    const Hit& h = hits_[i];
    const int beyond = across(h);
    stop_[i] = -1;
    if (beyond < 0) continue;
    for (const int t : {beyond, h.own})
      for (const int v : triangle(t))
        if (std::find(h.at.begin() + 2, h.at.end(), v) != h.at.end()) stop_[i] = v;
    if (stop_[i] < 0) continue;
    int& first = region_[stop_[i]];
    first < 0 ? void(first = i) : unite(group_, first, i);
  }
}

// A contour's length changes by -(R - (E R) / (E N) N) with the displacement of an edge along E against a triangle of
// normal N, where R is the sum of unit vectors along the pieces that meet there (Volino & Magnenat-Thalmann 2006).
void Contours::shorten() {
  for (int i = 0; i < int(hits_.size()); ++i) {
    Hit& h = hits_[i];
    Vec<double> r = {0, 0, 0};
    for (const int l : joined_[i]) {
      const Vec<double> d = hits_[links_[l].other(i)].spot - h.spot;
      const double length = std::sqrt(dot(d, d));
      if (length > 0) r = r + d / length;
    }
    const Vec<double>&a = at_[h.at[2]], e = at_[h.at[1]] - at_[h.at[0]], n = cross(at_[h.at[3]] - a, at_[h.at[4]] - a);
    r = r - (dot(e, r) / dot(e, n)) * n;
    const double size = std::sqrt(dot(r, r));
    if (size > 0) h.way = std::min(1 / kStraight, 1 / size) * r;
  }
  for (std::size_t i = 0; i < hits_.size(); ++i) hits_[i].contour = root(group_, int(i));
}

template const std::vector<Hit>& Contours::find(const float*, std::size_t, const std::vector<MeetingCells>&);
template const std::vector<Hit>& Contours::find(const double*, std::size_t, const std::vector<MeetingCells>&);

}  // namespace minicloth
