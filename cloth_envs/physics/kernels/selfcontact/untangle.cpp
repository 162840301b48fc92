#include "untangle.hpp"

#include <algorithm>
#include <cmath>

namespace minicloth {
namespace {

constexpr double kPart = 1;            // m/s, at which edges leave triangles, over how many hits a vertex is in
constexpr double kSmooth = 1;          // m/s, at which vertices go to the middle of their neighbours, at most,
constexpr double kSmoothTime = 0.004;  // s, or in this time
constexpr double kStretch = 0.1;       // strain, beyond which half of it is taken back in a step
constexpr int kRings = 2;              // vertices around those of hits whose edges that is done to
constexpr double kOutside = 0.5;       // of a triangle, up to which beside it an edge still counts

}  // namespace

template <class T>
void Untangle<T>::shape(const Sheet& sheet) {
  rows_ = sheet.rows, cols_ = sheet.cols, periodic_ = sheet.periodic;
  contours_.shape(rows_, cols_, periodic_), hits_.clear();
  rest_[0] = T(sheet.col_length), rest_[1] = T(sheet.row_length), rest_[2] = std::hypot(rest_[0], rest_[1]);
}

template <class T>
void Untangle<T>::find(const T* x, std::size_t plane, const std::vector<MeetingCells>& cells) {
  hits_ = contours_.find(x, plane, cells);
  if (!any()) return;
  crowd_.assign(std::size_t(rows_) * cols_, 0);
  for (const Hit& hit : hits_)
    for (const int vertex : hit.at) ++crowd_[vertex];
  gather_edges();
}

template <class T>
void Untangle<T>::gather_edges() {
  around_.assign(std::size_t(rows_) * cols_, 0), edges_.clear();
  for (const int v : contours_.tangled())
    for (int r = std::max(v / cols_ - kRings, 0); r <= std::min(v / cols_ + kRings, rows_ - 1); ++r)
      for (int c = v % cols_ - kRings; c <= v % cols_ + kRings; ++c)
        if (periodic_ || (c >= 0 && c < cols_)) around_[r * cols_ + (c + cols_) % cols_] = 1;
  const auto add = [&](int a, int b, T rest) {
    if (around_[a] && around_[b]) edges_.push_back({{a, b}, rest});
  };
  for (int v = 0; v < rows_ * cols_; ++v) {
    const int right = (v + 1) % cols_ ? v + 1 : periodic_ ? v + 1 - cols_ : -1;
    const bool below = v / cols_ + 1 < rows_;
    if (right >= 0) add(v, right, rest_[0]);
    if (below) add(v, v + cols_, rest_[1]);
    if (right >= 0 && below) add(v, right + cols_, rest_[2]), add(right, v + cols_, rest_[2]);
  }
}

template <class T>
Vec<T> Untangle<T>::get(const T* field, int vertex) const {
  const T* const from = field + strips_->places[vertex] + member_;
  return {from[0], from[strips_->width], from[2 * strips_->width]};
}

template <class T>
template <int most>
Vec<T> Untangle<T>::sum(const T* field, const Points<most>& points) const {
  Vec<T> d = {0, 0, 0};
  for (int i = 0; i < points.count; ++i) d = d + points.share[i] * get(field, points.at[i]);
  return d;
}

// Changes the velocity of a distance by kick, and the distance by shift and by what that adds to the way of the step.
template <class T>
template <int most>
void Untangle<T>::change(const Points<most>& points, const Vec<T>& kick, const Vec<T>& shift) {
  const int width = strips_->width;
  const auto mobility = [&](int i) { return mobility_[strips_->places[points.at[i]] + member_]; };
  T give = 0;
  for (int i = 0; i < points.count; ++i) give += points.share[i] * points.share[i] * mobility(i);
  if (!(give > 0)) return;
  for (int i = 0; i < points.count; ++i) {
    const int place = strips_->places[points.at[i]] + member_;
    const T part = mobility(i) * points.share[i] / give;
    const Vec<T> v = get(f_.v, points.at[i]) + part * kick;
    const Vec<T> x = get(f_.x, points.at[i]) + part * (h_ * kick + shift), y = x + damping_ * v;
    const auto put = [&](T* field, const Vec<T>& to) {
      field[place] = to.x, field[place + width] = to.y, field[place + 2 * width] = to.z;
    };
    put(f_.x, x), put(f_.v, v), put(f_.y, y);
  }
}

template <class T>
void Untangle<T>::step(const Fields<T>& f, const Strips<T>& s, int member, const std::vector<T>& mobility, T h,
                       T damping) {
  f_ = f, strips_ = &s, member_ = member, mobility_ = mobility.data(), h_ = h, damping_ = damping;
  for (const int vertex : contours_.tangled()) smooth(vertex);
  for (const Hit& hit : hits_) part(hit);
  for (const Edge& edge : edges_) shorten(edge);
}

// Towards the middle of its neighbours, and not away from it.
template <class T>
void Untangle<T>::smooth(int vertex) {
  int near[6];
  const int count = contours_.neighbours(vertex, near);
  if (!count) return;
  Points<7> points;
  points.add(vertex, 1);
  for (int i = 0; i < count; ++i) points.add(near[i], T(-1) / T(count));
  const Vec<T> d = sum(f_.x, points), u = sum(f_.v, points);
  const T far = std::sqrt(dot(d, d));
  if (!(far > T(1e-6))) return;
  const Vec<T> way = T(-1) / far * d;
  change(points, std::max(-dot(u, way), T(0)) * way, h_ * std::min(T(kSmooth), far / T(kSmoothTime)) * way);
}

// While an edge is in a triangle, it leaves it and does not go further in: to the side of its outer end, or as its
// contour becomes shorter.
template <class T>
void Untangle<T>::part(const Hit& hit) {
  Vec<T> x[5];
  for (int i = 0; i < 5; ++i) x[i] = get(f_.x, hit.at[i]);
  const Vec<T> e = x[3] - x[2], g = x[4] - x[2], n = cross(e, g);
  const T area = dot(n, n), p = dot(n, x[0] - x[2]), q = dot(n, x[1] - x[2]);
  if (!(area > 0) || !((p > 0 && q < 0) || (p < 0 && q > 0))) return;
  const T along = p / (p - q);
  const Vec<T> to = x[0] + along * (x[1] - x[0]) - x[2];
  const T b = dot(cross(to, g), n) / area, c = dot(cross(e, to), n) / area, a = 1 - b - c;
  if (!(std::min({a, b, c}) > T(-kOutside))) return;
  Vec<T> way = {T(hit.way.x), T(hit.way.y), T(hit.way.z)};
  if (hit.inside >= 0) way = ((hit.inside == 0) == (p > 0) ? -1 : 1) / std::sqrt(area) * n;
  const T rate = std::sqrt(dot(way, way));
  if (!(rate > 0)) return;
  Points<5> points;
  const T share[5] = {1 - along, along, -a, -b, -c};
  int crowd = 1;
  for (int i = 0; i < 5; ++i) points.add(hit.at[i], share[i]), crowd = std::max(crowd, crowd_[hit.at[i]]);
  const T u = dot(sum(f_.v, points), way) / (rate * rate);
  change(points, std::max(-u, T(0)) * way, h_ * T(kPart) / T(crowd) * way);
}

// Strain limits as of Provot (1995).
template <class T>
void Untangle<T>::shorten(const Edge& edge) {
  Points<2> points;
  points.add(edge.ends[0], 1), points.add(edge.ends[1], -1);
  const Vec<T> d = sum(f_.x, points);
  const T length = std::sqrt(dot(d, d)), over = length - T(1 + kStretch) * edge.rest;
  if (!(over > 0)) return;
  const Vec<T> way = T(-1) / length * d;
  change(points, std::max(-dot(sum(f_.v, points), way), T(0)) * way, over / 2 * way);
}

template class Untangle<float>;
template class Untangle<double>;

}  // namespace minicloth
