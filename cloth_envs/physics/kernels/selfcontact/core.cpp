#include "core.hpp"

#include <algorithm>
#include <cmath>

namespace minicloth {
namespace {

constexpr double kWindow = 0.01;    // s, for about how long ways are followed,
constexpr int kLeastWindow = 20;    // steps, and at least, if a frame has them: those of coarse cloths are longer
constexpr double kWatch = 0.4;      // cells, up to which distance blocks are watched that are not close
constexpr double kCheck = 0.5;      // of a window, from a search to a check, and between checks at most
constexpr int kTangledWindow = 31;  // steps, for at most how many while something crosses
constexpr int kEnd[3] = {1, 2, 3};  // corners where edges of a cell end: right, below, diagonal

template <class T>
bool sooner(const Close<T>& a, const Close<T>& b) {
  return a.at != b.at ? a.at < b.at : a.edges < b.edges;
}

}  // namespace

template <class T>
void SelfContact<T>::begin(const Sheet& sheet, const Strips<T>& s, const Fields<T>& f, int member, int count,
                           double damping) {
  layer_ = T(sheet.self_thickness), friction_ = T(sheet.self_friction), h_ = T(sheet.frame_dt / count),
  damping_ = T(damping);
  strips_ = &s, f_ = f, member_ = member, cell_area_ = sheet.row_length * sheet.col_length;
  const int windows = std::max(std::min(int(std::lround(sheet.frame_dt / kWindow)), count / kLeastWindow), 1);
  left_ = count_ = count, window_ = (count + windows - 1) / windows;
  sweep_.shape(sheet.rows, sheet.cols, sheet.periodic);
  mobility_.resize(s.field);
  for (int i = 0; i < int(s.places.size()); ++i) {
    const int r = i / sheet.cols, c = i % sheet.cols;
    const bool row = r == 0 || r == sheet.rows - 1, col = !sheet.periodic && (c == 0 || c == sheet.cols - 1);
    mobility_[s.places[i] + member] = T((row ? 2 : 1) * (col ? 2 : 1));
  }
  for (std::size_t i = 0; i < sheet.handles.size(); ++i)
    if (std::isinf(sheet.hold[3 * i])) mobility_[s.places[sheet.handles[i]] + member] = 0;
  for (int q = 0; q < 4; ++q) {
    corner_[q].resize(s.places.size());
    for (std::size_t i = 0; i < s.places.size(); ++i) corner_[q][i] = s.places[sweep_.corner[q][i]] + member;
  }
  crowd_.assign(s.field, 0), known_.assign(s.field, 0), before_.clear(), touched_.clear(), parts_.clear(),
      sweep_.pairs.clear();
  untangle_.shape(sheet);
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

// What may touch until the window ends.
template <class T>
void SelfContact<T>::search() {
  get(f_.x, sweep_.x), get(f_.v, sweep_.v);
  sweep_.time = sweep_.before = 0, sweep_.end = h_ * T(window_ + 1);
  std::fill(sweep_.fresh.begin(), sweep_.fresh.end(), 1);
  for (BlockPair<T>& pair : sweep_.pairs) pair.live = false;
  remember();
  sweep_.pairs.clear(), parts_.clear();
  for (auto& kind : due_)
    for (auto& due : kind) due.clear();
  since_ = 0, check_ = std::max(int(kCheck * window_), 1);
  find(true);
}

// The same again of blocks that strayed from their ways.
template <class T>
void SelfContact<T>::check() {
  sweep_.time = h_ * T(since_);
  get(f_.x, sweep_.x);
  const double worst = lanes<NearLanes<T>>().stray(sweep_);
  const int soon = std::max(int(kCheck * window_), 1);
  const int fresh = int(std::count(sweep_.fresh.begin(), sweep_.fresh.end(), 1));
  if (2 * fresh > sweep_.block_rows * sweep_.block_cols) return search();
  if (!fresh) {  // what strays grows with the square of time
    const double later = since_ * (std::sqrt(kTaken / std::max(worst, 1e-6)) - 1);
    check_ = since_ + std::min(std::max(int(later), 2), soon);
    return;
  }
  check_ = since_ + soon;
  get(f_.v, sweep_.v);
  for (BlockPair<T>& pair : sweep_.pairs) pair.live &= !(sweep_.fresh[pair.a] | sweep_.fresh[pair.b]);
  remember();
  const auto gone = [&](int part) { return !sweep_.pairs[parts_[part].owner].live; };
  for (auto& kind : due_)
    for (auto& due : kind) due.erase(std::remove_if(due.begin(), due.end(), gone), due.end());
  find(false);
}

template <class T>
void SelfContact<T>::find(bool all) {
  const auto& near = lanes<NearLanes<T>>();
  near.boxes(sweep_, T(cell_area_), all);
  near.blocks(sweep_, layer_, layer_, std::max(layer_, T(kWatch * std::sqrt(cell_area_))));
  near.cells(sweep_, 2 * layer_);
  first_.resize(sweep_.cells.size());
  const bool crossing = all && (left_ == count_ || untangle_.any());
  near.parts(sweep_, {layer_, layer_ / 2, h_}, layer_, crossing, first_.data());
  if (crossing) untangle();
  for (std::size_t p = 0; p < sweep_.cells.size(); ++p)
    if (first_[p].which && !untangle_.off(sweep_.cells[p].first, sweep_.cells[p].second))
      add(sweep_.cells[p], first_[p]);
}

// What crosses now; in a frame at whose start something does, searches are more frequent.
template <class T>
void SelfContact<T>::untangle() {
  meet_.clear();
  for (std::size_t p = 0; p < sweep_.cells.size(); ++p)
    if (first_[p].meet) meet_.push_back({sweep_.cells[p].first, sweep_.cells[p].second, first_[p].meet});
  untangle_.find(sweep_.x.data(), sweep_.plane, meet_);
  if (left_ < count_) return;
  crossings_ = untangle_.pairs();
  if (crossings_) window_ = std::min(window_, kTangledWindow);
}

template <class T>
void SelfContact<T>::add(const CellPair& cells, const FirstLooks& looks) {
  int at[2][4];
  for (int q = 0; q < 4; ++q) at[0][q] = corner_[q][cells.first], at[1][q] = corner_[q][cells.second];
  const auto missing = [&](const int (&cell)[4], int q) {  // an edge, as the sheet ends
    return cell[0] == cell[q] || (q == 3 && (cell[0] == cell[1] || cell[0] == cell[2]));
  };
  for (unsigned which = looks.which; which; which &= which - 1) {
    const int k = __builtin_ctz(which);
    Close<T> part = {{}, {0, 0, 0}, cells.blocks, k >= kVertexParts, false};
    std::array<int, 4>& x = part.at;
    if (!part.edges) {
      const int (&t)[4] = at[1 - k / 2];
      x = {at[k / 2][0], t[0], t[k % 2 ? 3 : 2], t[k % 2 ? 1 : 3]};
      if (missing(t, 3) || x[0] == x[1] || x[0] == x[2] || x[0] == x[3]) continue;
    } else {
      const int e = kEnd[(k - kVertexParts) / 3], g = kEnd[(k - kVertexParts) % 3];
      x = {at[0][0], at[0][e], at[1][0], at[1][g]};
      if (missing(at[0], e) || missing(at[1], g)) continue;
      if (x[0] == x[2] || x[0] == x[3] || x[1] == x[2] || x[1] == x[3]) continue;
    }
    if (known_[x[0]]) {
      const auto found = std::lower_bound(before_.begin(), before_.end(), part, sooner<T>);
      if (found != before_.end() && !sooner(part, *found)) {
        std::copy_n(found->side, 3, part.side), part.touched = true;
        touched_.push_back(int(parts_.size()));
      }
    }
    due_[part.edges][(now_ + looks.wait[k] - 1) % (kMostSteps + 1)].push_back(int(parts_.size()));
    parts_.push_back(part);
  }
}

// On which sides what touched is, before it is found again.
template <class T>
void SelfContact<T>::remember() {
  for (const Close<T>& part : before_) known_[part.at[0]] = 0;
  before_.clear();
  const auto gone = [&](int part) {
    if (sweep_.pairs[parts_[part].owner].live) return false;
    before_.push_back(parts_[part]), known_[parts_[part].at[0]] = 1;
    return true;
  };
  touched_.erase(std::remove_if(touched_.begin(), touched_.end(), gone), touched_.end());
  std::sort(before_.begin(), before_.end(), sooner<T>);
}

template <class T>
void SelfContact<T>::step() {
  ++since_;
  for (const bool edges : {false, true}) look(edges, due_[edges][now_]);
  if (untangle_.any()) untangle_.step(f_, *strips_, member_, mobility_, h_, damping_);
  now_ = (now_ + 1) % (kMostSteps + 1);
  if (--left_ == 0) return;
  if (since_ >= window_)
    search();
  else if (since_ >= check_)
    check();
}

template class SelfContact<float>;
template class SelfContact<double>;

}  // namespace minicloth
