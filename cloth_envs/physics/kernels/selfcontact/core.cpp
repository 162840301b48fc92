#include "core.hpp"

#include <algorithm>
#include <cmath>
#include <time.h>

#include "../base/vec.hpp"

double dbg_t[8];
double ph[2][8];
extern "C" __attribute__((visibility("default"))) double* minicloth_ph() { return ph[0]; }
extern "C" __attribute__((visibility("default"))) double* minicloth_dbg() { return dbg_t; }
namespace minicloth {
SelfStats self_stats;
double self_tune[16] = {1, 4, 12, 0.5, 0.3, 5, .1, 4, 0, 0, 0, 0, 0, 0, 0, .4};
long self_hist[20]; double self_min[4];
static double now_s() { timespec t; clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t); return t.tv_sec + 1e-9 * t.tv_nsec; }

namespace {
#define kEdges T(self_tune[0])      // of a layer's thickness, how near edges come
#define kEvery int(self_tune[1])    // steps between two looks at what is close
#define kSearch std::max(8, int(self_tune[2] * 1e-3 / h_))   // steps after which what may come close is searched for anew, at the latest
#define kSkin T(self_tune[3])       // layers, how far a vertex may be from where it was going until then
#define kPush T(self_tune[4])       // of what is missing, how much a step makes up for
#define kCalm T(1)
#define kPasses int(self_tune[7])
#define kCap T(self_tune[6])
#define kHaste T(self_tune[5])      // m/s, what speeds may change by until a pair is looked at again

constexpr int kPart[3] = {1, 2, 3};  // ends of the edges of a cell: right, below, diagonal

}  // namespace

template <class T>
void SelfContact<T>::begin(const Sheet& sheet, const Strips<T>& s, const Fields<T>& f, int member, double h,
                           double damping, const std::vector<int>& firm) {
  layer_ = T(self_tune[8]), friction_ = T(self_tune[9]), h_ = T(h), damping_ = T(damping);
  strips_ = &s, f_ = f, member_ = member, cell_area_ = sheet.row_length * sheet.col_length;
  sweep_.shape(sheet.rows, sheet.cols, sheet.periodic);
  haste_ = kHaste, most_ = std::max(2 * kSkin * layer_, T(2 * self_tune[15] * std::sqrt(cell_area_)));
  mobility_.resize(s.field);
  for (int i = 0; i < int(s.places.size()); ++i) {
    const int r = i / sheet.cols, c = i % sheet.cols;
    const bool row = r == 0 || r == sheet.rows - 1, col = !sheet.periodic && (c == 0 || c == sheet.cols - 1);
    mobility_[s.places[i] + member] = T((row ? 2 : 1) * (col ? 2 : 1));
  }
  for (int i : firm) mobility_[s.places[i] + member] = 0;
  for (int q = 0; q < 4; ++q) {
    corner_[q].resize(s.places.size());
    for (std::size_t i = 0; i < s.places.size(); ++i) corner_[q][i] = s.places[sweep_.corner[q][i]] + member;
  }
  known_.assign(s.field, 0), sides_.clear(), touched_.clear();
  self_stats.frames++;
  search();
}

template <class T>
void SelfContact<T>::get(const T* field, Plane<T>& to) const {
  const int n = int(strips_->places.size());
  for (int k = 0; k < 3; ++k) {
    const T* const from = field + k * strips_->width + member_;
    T* const plane = to.data() + k * sweep_.plane;
    for (int i = 0; i < n; ++i) plane[i] = from[strips_->places[i]];
  }
}

template <class T>
void SelfContact<T>::search() {
  const double t0 = now_s();
  get(f_.x, sweep_.x), get(f_.v, sweep_.v);
  ph[1][0]+=now_s()-t0;
  sweep_.time = sweep_.before = 0, sweep_.end = h_ * T(kSearch + 1);
  std::fill(sweep_.fresh.begin(), sweep_.fresh.end(), 1);
  remember();
  sweep_.pairs.clear();
  parts_.clear(), side_.clear(), owner_.clear();
  for (auto& kind : due_)
    for (auto& due : kind) due.clear();
  since_ = 0, check_ = kEvery;
  find(true);
  self_stats.search += now_s() - t0, self_stats.searches++;
}

template <class T>
void SelfContact<T>::check() {
  const double t0 = now_s();
  const T room = 2 * kSkin * layer_;
  T far;
  sweep_.time = h_ * T(since_);
  get(f_.x, sweep_.x);
  const T worst = lanes<NearLanes<T>>().stray(sweep_, room, most_, &far);
  haste_ = std::min(std::max(2 * far / sweep_.time, kCalm), kHaste);
  const double grows = std::sqrt(0.7 / std::max(double(worst), 1e-6)) - 1;
  const int many = int(std::count(sweep_.fresh.begin(), sweep_.fresh.end(), 1));
  check_ = since_ + (many ? kEvery : std::min(std::max(int(since_ * grows), 2), 16));
  ph[0][0]+=now_s()-t0; self_hist[1]++;
  if (!many) { self_stats.drift += now_s() - t0; return; }
  if (2 * many > sweep_.block_rows * sweep_.block_cols) return search();
  get(f_.v, sweep_.v);
  remember();
  for (BlockPair<T>& pair : sweep_.pairs) pair.live &= !(sweep_.fresh[pair.a] | sweep_.fresh[pair.b]);
  find(false);
  self_hist[0]++;
  self_stats.search += now_s() - t0, self_stats.searches++, self_stats.moved += many;
}

template <class T>
void SelfContact<T>::find(bool anew) {
  const auto& near = lanes<NearLanes<T>>();
  const T room = 2 * kSkin * layer_;
  double t1=now_s();
  near.boxes(sweep_, T(cell_area_), anew); double t2=now_s(); ph[anew][1]+=t2-t1;
  near.blocks(sweep_, layer_, room, most_); double t3=now_s(); ph[anew][2]+=t3-t2;
  near.cells(sweep_, layer_ + room); double t4=now_s(); ph[anew][3]+=t4-t3;
  const auto& pairs = sweep_.cells;
  first_.resize(pairs.size());
  const Looking<T> of[2] = {{layer_, layer_ / 2, haste_, h_}, {kEdges * layer_, kEdges * layer_ / 2, haste_, h_}};
  near.parts(sweep_, of[0], of[1], room, reinterpret_cast<std::uint8_t(*)[kParts + 2]>(first_.data()));
  double t5=now_s(); ph[anew][4]+=t5-t4;
  for (std::size_t p = 0; p < pairs.size(); ++p) {
    if (!first_[p][kParts] && !first_[p][kParts + 1]) continue;
    int at[2][4];
    for (int q = 0; q < 4; ++q) at[0][q] = corner_[q][pairs[p].first], at[1][q] = corner_[q][pairs[p].second];
    for (int k = 0; k < kParts; ++k) {
      const int wait = first_[p][k];
      if (!wait) continue;
      std::array<int, 4> x;
      bool none;
      if (k < kVertexParts) {
        const int* const t = at[1 - k / 2];
        x = {at[k / 2][0], t[0], k % 2 ? t[3] : t[2], k % 2 ? t[1] : t[3]};
        none = t[0] == t[1] || t[0] == t[2] || x[0] == x[1] || x[0] == x[2] || x[0] == x[3];
      } else {
        const int e = kPart[(k - 4) / 3], g = kPart[(k - 4) % 3];
        x = {at[0][0], at[0][e], at[1][0], at[1][g]};
        const auto point = [&](const int* q, int m) { return m == 3 ? q[0] == q[1] || q[0] == q[2] : q[0] == q[m]; };
        none = point(at[0], e) || point(at[1], g) || x[0] == x[2] || x[0] == x[3] || x[1] == x[2] || x[1] == x[3];
      }
      if (none) continue;
      due_[k >= kVertexParts][(now_ + wait - 1) % (kMostSteps + 1)].push_back(int(parts_.size()));
      parts_.push_back(x), side_.push_back({}), owner_.push_back(pairs[p].blocks);
      if (known_[x[0]]) {
        const auto found = std::lower_bound(sides_.begin(), sides_.end(), x, [](const auto& a, const auto& b) { return a.first < b; });
        if (found != sides_.end() && found->first == x) side_.back() = found->second;
      }
    }
  }
  ph[anew][5]+=now_s()-t5; ph[anew][6]+=1; ph[anew][7]+=pairs.size();
  self_stats.ee += parts_.size();
  self_stats.blocks += sweep_.close.size(), self_stats.cells += pairs.size();
}

template <class T>
void SelfContact<T>::remember() {
  for (const auto& side : sides_) known_[side.first[0]] = 0;
  sides_.clear();
  for (const int part : touched_)
    sides_.push_back({parts_[part], side_[part]}), known_[parts_[part][0]] = 1;
  std::sort(sides_.begin(), sides_.end());
  touched_.clear();
}

template <class T>
void SelfContact<T>::step() {
  ++since_;
  double t0 = now_s();
  for (const bool edges : {false, true}) look(edges, due_[edges][now_]);
  now_ = (now_ + 1) % (kMostSteps + 1);
  self_stats.resolve += now_s() - t0, self_stats.checks++;
  t0 = now_s();
  if (since_ >= kSearch) search();
  else if (since_ >= check_) check();
}

template <class T>
void SelfContact<T>::look(bool edges, std::vector<int>& which) {
  which.erase(std::remove_if(which.begin(), which.end(), [&](int part) { return !sweep_.pairs[owner_[part]].live; }), which.end());
  const int count = int(which.size());
  if (!count) return;
  self_stats.hits += count;
  wait_.resize(count);
  const T reach = edges ? kEdges * layer_ : layer_;
  const Looking<T> how = {reach, reach / 2, haste_, h_};
  const auto* parts = reinterpret_cast<const int(*)[4]>(parts_.data());
  lanes<NearLanes<T>>().look(f_.x, f_.v, strips_->width, parts, which.data(), count, edges, how,
                         reinterpret_cast<T(*)[3]>(side_.data()), wait_.data());
  acts_.clear();
  for (int i = 0; i < count; ++i) {
    const int steps = wait_[i] & (kAct - 1);
    if (wait_[i] & kAct) acts_.push_back({which[i], steps});
    due_[edges][(now_ + steps) % (kMostSteps + 1)].push_back(which[i]);
  }
  std::sort(acts_.begin(), acts_.end());
  bool deep = true;
  for (int pass = 0; pass < kPasses && deep; ++pass) {
    deep = false;
    for (const auto& [part, steps] : acts_) deep |= resolve(part, edges, steps);
  }
  for (const auto& act : acts_) touched_.push_back(act.first);
  due_[edges][now_].clear();
}

namespace {

template <class T>
T clamp01(T t) {
  return t < T(0) ? T(0) : t > T(1) ? T(1) : t;
}

// Shares of b and c in the point of a triangle a, b, c that is nearest to p.
template <class T>
void nearest_in_triangle(const Vec<T>& p, const Vec<T>& a, const Vec<T>& b, const Vec<T>& c, T* v, T* w) {
  const Vec<T> ab = b - a, ac = c - a, ap = p - a;
  const T d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return void(*v = *w = 0);
  const Vec<T> bp = p - b;
  const T d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return void((*v = 1, *w = 0));
  const T vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return void((*v = d1 / (d1 - d3), *w = 0));
  const Vec<T> cp = p - c;
  const T d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return void((*v = 0, *w = 1));
  const T vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return void((*v = 0, *w = d2 / (d2 - d6)));
  const T va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    *w = (d4 - d3) / ((d4 - d3) + (d5 - d6)), *v = 1 - *w;
    return;
  }
  const T sum = va + vb + vc;
  *v = vb / sum, *w = vc / sum;
}

template <class T>
void nearest_on_edges(const Vec<T>& p, const Vec<T>& d, const Vec<T>& q, const Vec<T>& e, T* s, T* t) {
  const Vec<T> r = p - q;
  const T a = dot(d, d), b = dot(d, e), c = dot(d, r), g = dot(e, e), f = dot(e, r), den = a * g - b * b;
  *s = den > T(1e-6) * a * g ? clamp01<T>((b * f - c * g) / den) : T(0);
  *t = (b * *s + f) / g;
  if (*t < 0 || *t > 1) *t = clamp01<T>(*t), *s = clamp01<T>((b * *t - c) / a);
}

}  // namespace

template <class T>
bool SelfContact<T>::resolve(int part, bool edges, int steps) {
  const int width = strips_->width;
  const T reach = edges ? kEdges * layer_ : layer_, time = h_ * T(steps);
  const auto& place = parts_[part];
    Vec<T> x[4], v[4];
    T weight[4], mobility[4];
    for (int q = 0; q < 4; ++q) {
      mobility[q] = mobility_[place[q]];
      const T *const px = f_.x + place[q], *const pv = f_.v + place[q];
      x[q] = {px[0], px[width], px[2 * width]}, v[q] = {pv[0], pv[width], pv[2 * width]};
    }
    if (edges) {
      T s, t;
      nearest_on_edges(x[0], x[1] - x[0], x[2], x[3] - x[2], &s, &t);
      weight[0] = 1 - s, weight[1] = s, weight[2] = t - 1, weight[3] = -t;
    } else {
      T b, c;
      nearest_in_triangle(x[0], x[1], x[2], x[3], &b, &c);
      weight[0] = 1, weight[1] = b + c - 1, weight[2] = -b, weight[3] = -c;
    }
    Vec<T> d = {0, 0, 0}, u = {0, 0, 0};
    T give = 0;
    for (int q = 0; q < 4; ++q)
      d = d + weight[q] * x[q], u = u + weight[q] * v[q], give += weight[q] * weight[q] * mobility[q];
    if (!(give > 0)) return false;
    const Vec<T> side = vec(side_[part].data());
    const T far = std::sqrt(dot(d, d)), along = dot(d, side);
    const Vec<T> n = far > T(1e-6) ? d / (along < 0 ? -far : far) : side;
    const T apart = along < 0 ? -far : far, gap = apart - reach;
    const T un = dot(u, n), least = gap > 0 ? -gap / time : T(0);
    if (un >= least && gap >= 0) return false;
    const T stop = un < least ? least - un : T(0), back = gap < 0 ? std::min(h_ * stop, -gap) : T(0), rest = -gap - back;
    const T push = apart < 0 ? -apart : gap < 0 ? back + std::min(kPush * rest, kCap * layer_) : T(0);
    const Vec<T> slide = u - un * n;
    const T sliding = std::sqrt(dot(slide, slide)), hold = sliding > 0 ? std::min(friction_ * stop / sliding, T(1)) : T(0);
    self_stats.moved++;
    for (int q = 0; q < 4; ++q) {
      const T share = mobility[q] * weight[q] / give;
      v[q] = v[q] + share * (stop * n - hold * slide), x[q] = x[q] + (share * push) * n;
      T *const px = f_.x + place[q], *const pv = f_.v + place[q], *const py = f_.y + place[q];
      px[0] = x[q].x, px[width] = x[q].y, px[2 * width] = x[q].z;
      pv[0] = v[q].x, pv[width] = v[q].y, pv[2 * width] = v[q].z;
      py[0] = x[q].x + damping_ * v[q].x, py[width] = x[q].y + damping_ * v[q].y;
      py[2 * width] = x[q].z + damping_ * v[q].z;
    }
  return gap < -reach / 2;
}

template class SelfContact<float>;
template class SelfContact<double>;

}  // namespace minicloth

extern "C" __attribute__((visibility("default"))) minicloth::SelfStats* minicloth_stats() { return &minicloth::self_stats; }
extern "C" __attribute__((visibility("default"))) double* minicloth_min() { return minicloth::self_min; }
extern "C" __attribute__((visibility("default"))) long* minicloth_hist() { return minicloth::self_hist; }
extern "C" __attribute__((visibility("default"))) double* minicloth_tune() { return minicloth::self_tune; }
