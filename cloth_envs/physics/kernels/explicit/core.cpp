#include "core.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "../base/threads.hpp"
#include "../selfcontact/core.hpp"
#include "../sheet/air.hpp"
#include "driven.hpp"
#include "tracking.hpp"

namespace minicloth {
namespace {

constexpr int kLook = 8;  // substeps for which bodies stay near or far; fewer at first, as cloth may speed up from rest
constexpr std::size_t kCache = 1 << 20;  // bytes that the fields of cloths in lanes may take

// One thread's fields. Where no vertex is they are zeros and stay so, but for what is not finite.
template <class T>
struct Workspace {
  Plane<T> memory;
  std::vector<std::ptrdiff_t> shape;
  Fields<T> prepare(const Strips<T>& s) {
    const std::size_t line = (s.cols + 2) * 4 * s.width;
    const std::vector<std::ptrdiff_t> wanted = {
        s.rows, s.cols, s.width, s.banded, s.periodic, s.turned, std::ptrdiff_t(s.places.size())};
    if (shape != wanted) memory.assign(7 * s.field + 3 * line, T(0)), shape = wanted;
    T* at = memory.data();
    Fields<T> f;
    for (T** field : {&f.x, &f.y, &f.v, &f.slow, &f.ahead, &f.mid, &f.past}) *field = std::exchange(at, at + s.field);
    for (T** row : {&f.arrive, &f.first, &f.low}) *row = std::exchange(at, at + line) + 4 * s.width;
    return f;
  }
};

// Of lane `l`, for steps of `h` whose velocities change as in steps of `dt`.
template <class T>
void put_terms(StepTerms<T>& t, int l, const Material& m, double gravity, double h, double dt) {
  // Drag is integrated exactly: dv/dt = a - drag v over a substep with a constant.
  const double lag = m.drag > 0 ? -std::expm1(-m.drag * dt) / m.drag : dt;
  // A spring shortened by e has the tension -k c (min(e, b) + q max(e - b, 0)), b the length at which it buckles. On
  // top of a linear spring's -k e that is k (1 - c q) e and -k c (1 - q) min(e, b).
  const double c = m.compression, q = m.post_buckling;
  t.stretch[l] = T(m.stretch_stiffness), t.shear[l] = T(m.shear_stiffness), t.damping[l] = T(m.damping);
  t.yields[l] = T(c * q - 1), t.buckled[l] = T(c - c * q), t.buckling[l] = T(m.buckling_strain);
  t.shortened_damping[l] = T(m.compression_damping);
  t.accelerate[l] = T(lag / m.areal_density), t.decay[l] = T(std::exp(-m.drag * dt));
  t.gravity_kick[l] = T(lag * gravity), t.dt[l] = T(h);
}

template <class T>
void put_slow(SlowTerms<T>& t, int l, const Material& m, const Sheet& sheet, const Frame<T>& f, bool turned) {
  const AirTerms<T> air = air_terms(sheet, f);
  t.bend[l] = T(m.bend_stiffness), t.twist[l] = T(m.twist);
  t.normal[l] = air.normal, t.lift[l] = air.lift, t.tangential[l] = air.tangential;
  t.pressure[l] = turned ? -air.pressure : air.pressure;  // normals turn round
  for (int k = 0; k < 3; ++k) t.wind[k][l] = air.wind[k];
}

// A field (3, H, W) of cloth `member`.
template <class T>
void put(const Strips<T>& s, const T* from, int member, T* field) {
  for (int k = 0; k < 3; ++k, field += s.width, from += s.places.size())
    for (const int vertex : s.order) field[s.places[vertex] + member] = from[vertex];
}
// And back; whether all of it is finite.
template <class T>
bool take(const Strips<T>& s, const T* field, int member, T* to) {
  T none = 0;
  for (int k = 0; k < 3; ++k, field += s.width, to += s.places.size())
    for (const int vertex : s.order) none += T(0) * (to[vertex] = field[s.places[vertex] + member]);
  return none == 0;
}

}  // namespace

// From substep `first` to the middle of the kicks before `end`, in substeps; a frame's first and last kick are half.
double middle(int first, int end, int count) {
  double all = 0, moment = 0;
  for (int k = first; k < end; ++k) {
    const double share = k == 0 || k == count ? 0.5 : 1;
    all += share, moment += share * (k - first);
  }
  return moment / all;
}

template <class T>
Explicit<T>::Explicit(Sheet sheet, std::vector<double> sheared)
    : sheet_(std::move(sheet)),
      sheared_(std::move(sheared)),
      bands_(sheet_.rows, sheet_.cols, sheet_.row_length, sheet_.col_length, sheet_.periodic,
             lanes<ExplicitLanes<T>>().width, true),
      cloths_(sheet_.rows, sheet_.cols, sheet_.row_length, sheet_.col_length, sheet_.periodic, bands_.width, false) {}

template <class T>
bool Explicit<T>::advance(const std::vector<Frame<T>>& frames, const std::vector<Material>& materials,
                          const Substeps& substeps, const std::vector<std::size_t>& members, const Tracking* tracking,
                          int* crossings) const {
  const auto& kernels = lanes<ExplicitLanes<T>>();
  const Strips<T>& s = members.size() > 1 ? cloths_ : bands_;
  const int width = s.width, count = substeps.count;
  thread_local Workspace<T> work;
  const Fields<T> f = work.prepare(s);
  const double h = sheet_.frame_dt / count;

  StepTerms<T> full, half, last;
  SlowTerms<T> slow;
  HeldVertices<T> handles;
  LaneBodies<T> bodies(sheet_);
  bool simple = true, bends = false;
  for (int lane = 0; lane < (s.banded ? 1 : width); ++lane) {  // lanes without a cloth repeat the last one
    const std::size_t member = members[std::min<std::size_t>(lane, members.size() - 1)];
    const Frame<T>& frame = frames[member];
    const Material& material = materials[member];
    const int end = s.banded ? width : lane + 1;
    for (int l = lane; l < end; ++l) {
      put_terms(full, l, material, sheet_.gravity, h, h), put_terms(half, l, material, sheet_.gravity, h, h / 2);
      put_terms(last, l, material, sheet_.gravity, h / 2, h / 2), put_slow(slow, l, material, sheet_, frame, s.turned);
    }
    put(s, frame.x, lane, f.x), put(s, frame.v, lane, f.v);
    handles.add(sheet_, frame, material, s, lane), bodies.add(sheet_, frame, lane, end);
    simple &= material.simple(), bends |= material.bend_stiffness > 0;
  }

  for (std::ptrdiff_t i = 0; i < s.field; i += width)
    for (int l = 0; l < width; ++l) f.y[i + l] = f.x[i + l] + full.damping[l] * f.v[i + l];

  const auto slow_forces = kernels.slow[bends][sheet_.air][sheet_.pressure];
  if (!slow_forces) std::fill_n(f.slow, s.field, T(0));
  const int held = substeps.held;
  const std::size_t folding = sheet_.self_thickness > 0 ? members.size() : 0;
  thread_local std::vector<SelfContact<T>> selves;
  if (selves.size() < folding) selves.resize(folding);
  for (std::size_t m = 0; m < folding; ++m) selves[m].begin(sheet_, s, f, int(m), count, materials[members[m]].damping);
  std::vector<PullMeans<T>> means;
  std::vector<PullShared<T>> shared;
  if (tracking && tracking->means) means.emplace_back(*tracking, sheet_, s, materials, members, substeps);
  for (std::size_t m = 0; tracking && !tracking->means && m < members.size(); ++m)
    shared.emplace_back(*tracking, sheet_, s, materials[members[m]], members[m], int(m), count);
  thread_local std::vector<Near> near;
  for (int k = 0; k <= count; ++k) {
    if (slow_forces && k % held == 0) {
      const double later = middle(k, std::min(k + held, count + 1), count), since = k > held ? held : held - 0.5;
      std::fill_n(slow.later, width, T(h * later));
      slow.trend = T(k ? (later + 0.5) / since : 0);  // velocities are half a substep old, but at a frame's start
      slow_forces(s, f, slow);
    }
    if (tracking && !slow_forces && k % held == 0) std::fill_n(f.slow, s.field, T(0));
    for (PullMeans<T>& pull : means)
      if (k % held == 0) pull.step(f, k);
    for (PullShared<T>& pull : shared) pull.step(f, k, k % held == 0);
    if (k == 0) handles.pull(f, width, 0, -h / 2);
    const bool doubled = k < kLook && (k & (k - 1)) == 0;
    const int ahead = doubled ? std::max(k, 1) : k % kLook == 0 ? kLook : 0;  // substeps, 0: seen already
    if (ahead) bodies.look(k / double(count), (k + ahead) / double(count));
    const std::vector<BodyLanes<T>>& now = bodies.to((k + (k < count ? 1 : 0.5)) / count);
    if (!now.empty() && ahead) kernels.near(s, f, full, now, ahead, near);
    const Part part = k == count ? Part::kLast : now.empty() ? Part::kFree : Part::kBodies;
    kernels.step[simple][int(part)](s, f, k == count ? last : k ? full : half, now, near);
    handles.hold(f, full, width, std::min(k + 1, count) / double(count), k < count ? h : 0);
    for (std::size_t m = 0; k < count && m < folding; ++m) selves[m].step();
  }
  handles.pull(f, width, 1, h / 2);
  for (std::size_t m = 0; m < members.size(); ++m) crossings[members[m]] = m < folding ? selves[m].crossings() : 0;
  bool finite = true;
  for (std::size_t m = 0; m < members.size(); ++m) {
    const Frame<T>& frame = frames[members[m]];
    finite &= take(s, f.x, int(m), frame.x_out) & take(s, f.v, int(m), frame.v_out);
  }
  if (!finite) work.shape.clear();
  return finite;
}

template <class T>
void Explicit<T>::advance(const std::vector<Frame<T>>& frames, const std::vector<Material>& materials,
                          const std::vector<Cuts>& cuts, const Tracking* tracking, int threads,
                          const std::vector<std::size_t>& which, const int* levels, int* ends, int* crossings) const {
  // Bands fill the lanes of a large cloth; of small ones several that step alike fill them better.
  std::vector<std::vector<std::size_t>> groups;
  const std::size_t most = std::size_t(bands_.width);
  const bool small = !sheet_.periodic && 4 * sizeof(T) * cloths_.field < kCache;
  const auto substeps = [&](std::size_t i) -> const Substeps& { return cuts[i].levels[levels[i]]; };
  const auto whole = [&](const T* field) {
    return std::all_of(field, field + 3 * sheet_.rows * sheet_.cols, [](T v) { return std::isfinite(v); });
  };
  for (const std::size_t i : which) {
    const auto alike = [&](const std::vector<std::size_t>& group) {
      const std::size_t first = group.front();
      return group.size() < most && substeps(first) == substeps(i) &&
             materials[first].simple() == materials[i].simple() &&
             (materials[first].bend_stiffness > 0) == (materials[i].bend_stiffness > 0);
    };
    const auto found = small ? std::find_if(groups.begin(), groups.end(), alike) : groups.end();
    found == groups.end() ? groups.push_back({i}) : found->push_back(i);
  }
  for_each_member(groups.size(), threads, [&](std::size_t g) {
    const bool finite = advance(frames, materials, substeps(groups[g].front()), groups[g], tracking, crossings);
    for (const std::size_t i : groups[g]) {
      const Frame<T>& f = frames[i];
      const bool blown = !finite && !(whole(f.x_out) && whole(f.v_out)) && whole(f.x) && whole(f.v);
      ends[i] = blown ? int(sheared_.size()) - 1 : level(f.x_out, f.v_out, cuts[i].fast);
    }
  });
}

template <class T>
double Explicit<T>::shear(const T* x) const {
  const double flat = 4 * sheet_.row_length * sheet_.col_length;
  return lanes<ExplicitLanes<T>>().slant(sheet_.rows, sheet_.cols, x) / flat;
}

template <class T>
double Explicit<T>::apart(const T* v) const {
  return std::sqrt(double(lanes<ExplicitLanes<T>>().apart(sheet_.rows, sheet_.cols, v)));
}

template <class T>
int Explicit<T>::level(const T* x, const T* v, double fast) const {
  const auto last = sheared_.end() - 1;
  return int((apart(v) > fast ? last : std::lower_bound(sheared_.begin(), last, shear(x))) - sheared_.begin());
}

template <class T>
void Explicit<T>::advance(const std::vector<Frame<T>>& frames, const std::vector<Material>& materials,
                          const std::vector<Cuts>& cuts, const Tracking* tracking, int threads, int* levels,
                          int* crossings) const {
  std::vector<std::size_t> which(frames.size());
  std::iota(which.begin(), which.end(), std::size_t(0));
  for (const std::size_t i : which) levels[i] = level(frames[i].x, frames[i].v, cuts[i].fast);
  std::vector<int> ends(frames.size());
  while (!which.empty()) {
    advance(frames, materials, cuts, tracking, threads, which, levels, ends.data(), crossings);
    std::vector<std::size_t> again;
    for (const std::size_t i : which) {
      const Substeps before = cuts[i].levels[levels[i]];
      levels[i] = std::max(levels[i], ends[i]);
      if (!(cuts[i].levels[levels[i]] == before)) again.push_back(i);
    }
    which = again;
  }
}

template class Explicit<float>;
template class Explicit<double>;

}  // namespace minicloth
