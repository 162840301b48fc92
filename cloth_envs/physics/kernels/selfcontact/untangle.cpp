#include "untangle.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace minicloth {
namespace {

double knob(const char* name, double value) { return std::getenv(name) ? std::atof(std::getenv(name)) : value; }
const double kSpeed = knob("U_SPEED", 1);    // m/s, at which edges leave triangles, over how many a vertex is in
const double kSSpeed = knob("U_SSPEED", 1), kTau = knob("U_TAU", 0.004), kLimit = knob("U_LIMIT", 100), kStop = knob("U_STOP", 1),
             kSStop = knob("U_SSTOP", 1), kVTau = knob("U_VTAU", 1e9), kMost = knob("U_MOST", 100), kHard = knob("U_HARD", 0.5);

template <class T, int n>
struct Points {
  int place[n];
  T share[n];
};

}  // namespace

template <class T>
void Untangle<T>::shape(const Sheet& sheet) {
  contours_.shape(sheet.rows, sheet.cols, sheet.periodic);
  crowd_.resize(std::size_t(sheet.rows) * sheet.cols), slack_.assign(crowd_.size(), T(1));
  rest_[0] = T(sheet.col_length), rest_[1] = T(sheet.row_length), rest_[2] = std::hypot(rest_[0], rest_[1]);
  rows_ = sheet.rows, cols_ = sheet.cols, periodic_ = sheet.periodic;
  hits_ = nullptr;
}

template <class T>
bool Untangle<T>::find(const T* x, std::size_t plane, const std::vector<std::array<int, 2>>& cells) {
  const std::vector<Hit>& hits = contours_.find(x, plane, cells);
  hits_ = hits.empty() ? nullptr : &hits;
  if (!hits_) return false;
  std::fill(crowd_.begin(), crowd_.end(), 0);
  for (const Hit& hit : hits)
    for (const int vertex : hit.at) ++crowd_[vertex];
  // edges within 2 rings
  edges_.clear();
  std::vector<char> in(crowd_.size(), 0);
  for (int v : contours_.tangled()) {
    int r = v / cols_, c = v % cols_;
    for (int i = std::max(r - 2, 0); i <= std::min(r + 2, rows_ - 1); ++i)
      for (int j = c - 2; j <= c + 2; ++j)
        if (periodic_ || (j >= 0 && j < cols_)) in[i * cols_ + (j + cols_) % cols_] = 1;
  }
  for (int v = 0; v < rows_ * cols_; ++v) {
    if (!in[v]) continue;
    const int r = (v + 1) % cols_ ? v + 1 : periodic_ ? v + 1 - cols_ : -1, d = v + cols_ < rows_ * cols_ ? v + cols_ : -1;
    if (r >= 0 && in[r]) edges_.push_back({v, r, rest_[0]});
    if (d >= 0 && in[d]) edges_.push_back({v, d, rest_[1]});
    if (r >= 0 && d >= 0 && in[r + cols_]) edges_.push_back({v, r + cols_, rest_[2]});
    if (r >= 0 && d >= 0 && in[r] && in[d]) edges_.push_back({r, d, rest_[2]});
  }
  return true;
}

template <class T>
void Untangle<T>::step(const Fields<T>& f, const Strips<T>& s, int member, const std::vector<T>& mobility, T h,
                       T damping) {
  f_ = f, s_ = &s, member_ = member, mobility_ = mobility.data(), h_ = h, damping_ = damping;
  if (kLimit < 50) strain();
  if (kSSpeed > 0) smooth();
  for (const Hit& hit : *hits_) part(hit);
  if (kMost < 50) limit();
}

template <class T>
void Untangle<T>::strain() {
  for (const auto& e : edges_) slack_[e.a] = slack_[e.b] = 0;
  const int width = s_->width;
  for (const auto& e : edges_) {
    const T *p = f_.x + s_->places[e.a] + member_, *q = f_.x + s_->places[e.b] + member_;
    const Vec<T> d = {p[0] - q[0], p[width] - q[width], p[2 * width] - q[2 * width]};
    const T st = std::sqrt(dot(d, d)) / e.rest - 1;
    slack_[e.a] = std::max(slack_[e.a], st), slack_[e.b] = std::max(slack_[e.b], st);
  }
  for (const auto& e : edges_)
    for (int v : {e.a, e.b})
      if (slack_[v] >= 0) slack_[v] = -std::min(std::max(1 - slack_[v] / T(kLimit), T(0)), T(1)) - T(1e-9);
  for (const auto& e : edges_)
    for (int v : {e.a, e.b}) slack_[v] = std::abs(slack_[v]);
}

template <class T>
void Untangle<T>::limit() {
  const int width = s_->width;
  for (const auto& e : edges_) {
    const int pa = s_->places[e.a] + member_, pb = s_->places[e.b] + member_;
    T *p = f_.x + pa, *q = f_.x + pb, *v = f_.v + pa, *w = f_.v + pb;
    const Vec<T> d = {p[0] - q[0], p[width] - q[width], p[2 * width] - q[2 * width]};
    const T length = std::sqrt(dot(d, d)), over = length - (1 + T(kMost)) * e.rest, give = mobility_[pa] + mobility_[pb];
    if (!(over > 0) || !(give > 0)) continue;
    const Vec<T> n = d / length, u = {v[0] - w[0], v[width] - w[width], v[2 * width] - w[2 * width]};
    const T stop = std::max(dot(u, n), T(0)), move = T(kHard) * over + h_ * stop;
    for (int side = 0; side < 2; ++side) {
      const int pl = side ? pb : pa;
      const T part = (side ? 1 : -1) * mobility_[pl] / give;
      T *px = f_.x + pl, *pv = f_.v + pl, *py = f_.y + pl;
      const T* nn = &n.x;
      for (int k = 0; k < 3; ++k) {
        px[k * width] += part * move * nn[k], pv[k * width] += part * stop * nn[k];
        py[k * width] = px[k * width] + damping_ * pv[k * width];
      }
    }
  }
}

template <class T>
void Untangle<T>::part(const Hit& hit) {
  const int width = s_->width;
  Vec<T> x[5], v[5];
  int place[5], crowd = 1;
  T slack = 1;
  for (int q = 0; q < 5; ++q) {
    place[q] = s_->places[hit.at[q]] + member_, crowd = std::max(crowd, crowd_[hit.at[q]]);
    slack = std::min(slack, slack_[hit.at[q]]);
    const T *const px = f_.x + place[q], *const pv = f_.v + place[q];
    x[q] = {px[0], px[width], px[2 * width]}, v[q] = {pv[0], pv[width], pv[2 * width]};
  }
  const Vec<T> e = x[3] - x[2], g = x[4] - x[2], n = cross(e, g);
  const T area = std::sqrt(dot(n, n));
  if (!(area > 0)) return;
  const T p = dot(n, x[0] - x[2]), q = dot(n, x[1] - x[2]);
  if (!((p > 0 && q < 0) || (p < 0 && q > 0))) return;
  const T along = p / (p - q);
  const Vec<T> to = x[0] + along * (x[1] - x[0]) - x[2];
  const T b = dot(cross(to, g), n) / (area * area), c = dot(cross(e, to), n) / (area * area), a = 1 - b - c;
  if (!(a > T(-0.5) && b > T(-0.5) && c > T(-0.5))) return;
  const T share[5] = {1 - along, along, -a, -b, -c};
  Vec<T> way = {T(hit.way.x), T(hit.way.y), T(hit.way.z)};
  if (hit.inside >= 0) way = ((hit.inside == 0) == (p > 0) ? -1 : 1) / area * n;
  const T rate = std::sqrt(dot(way, way));
  if (!(rate > 0)) return;
  way = way / rate;
  T give = 0;
  Vec<T> u = {0, 0, 0};
  for (int i = 0; i < 5; ++i) give += share[i] * share[i] * mobility_[place[i]], u = u + share[i] * v[i];
  if (!(give > 0)) return;
  const T stop = slack * T(kStop) * std::max(-dot(u, way), T(0)), more = slack * h_ * T(kSpeed) * rate / T(crowd);
  for (int i = 0; i < 5; ++i) {
    const T part = mobility_[place[i]] * share[i] / give;
    const Vec<T> w = v[i] + (part * stop) * way, at = x[i] + (part * (h_ * stop + more)) * way, y = at + damping_ * w;
    T *const px = f_.x + place[i], *const pv = f_.v + place[i], *const py = f_.y + place[i];
    px[0] = at.x, px[width] = at.y, px[2 * width] = at.z;
    pv[0] = w.x, pv[width] = w.y, pv[2 * width] = w.z;
    py[0] = y.x, py[width] = y.y, py[2 * width] = y.z;
  }
}

template <class T>
void Untangle<T>::smooth() {
  const int width = s_->width;
  for (const int v : contours_.tangled()) {
    int near[6];
    const int n = contours_.neighbours(v, near);
    if (!n) continue;
    int place[7] = {s_->places[v] + member_};
    T share[7] = {1};
    for (int k = 0; k < n; ++k) place[k + 1] = s_->places[near[k]] + member_, share[k + 1] = T(-1) / n;
    Vec<T> d = {0, 0, 0}, u = {0, 0, 0};
    T give = 0;
    for (int k = 0; k <= n; ++k) {
      const T *const px = f_.x + place[k], *const pv = f_.v + place[k];
      d = d + share[k] * Vec<T>{px[0], px[width], px[2 * width]}, u = u + share[k] * Vec<T>{pv[0], pv[width], pv[2 * width]};
      give += share[k] * share[k] * mobility_[place[k]];
    }
    const T far = std::sqrt(dot(d, d));
    if (!(far > T(1e-6)) || !(give > 0)) continue;
    const Vec<T> way = T(-1) / far * d;
    const T stop = T(kSStop) * std::max(-dot(u, way), T(0)), more = h_ * std::min(T(kSSpeed), far / T(kTau));
    const Vec<T> kick = stop * way - std::min(h_ / T(kVTau), T(1)) * (u + stop * way);
    for (int i = 0; i <= n; ++i) {
      const T part = mobility_[place[i]] * share[i] / give;
      T *const px = f_.x + place[i], *const pv = f_.v + place[i], *const py = f_.y + place[i];
      const Vec<T> w = Vec<T>{pv[0], pv[width], pv[2 * width]} + part * kick;
      const Vec<T> at = Vec<T>{px[0], px[width], px[2 * width]} + part * (h_ * kick + more * way), y = at + damping_ * w;
      px[0] = at.x, px[width] = at.y, px[2 * width] = at.z;
      pv[0] = w.x, pv[width] = w.y, pv[2 * width] = w.z;
      py[0] = y.x, py[width] = y.y, py[2 * width] = y.z;
    }
  }
}

template class Untangle<float>;
template class Untangle<double>;

}  // namespace minicloth
