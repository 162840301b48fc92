#include "separate.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "../selfcontact/crossing.hpp"
#include "meet.hpp"

namespace minicloth {
namespace {

constexpr int kHalves = 3, kFacets = 8, kRounds = 24;  // up to which round half-way, to the facets, between neighbours
constexpr int kLeft = 8;                               // rounds into the facets of what still crosses
constexpr int kSpread = 2;                             // rings of vertices around them, which are drawn
constexpr float kLess = 0.6f;                          // times as much from ring to ring
constexpr float kThere = 1e-6f;                        // m along an axis, up to which a vertex is in its facet

// Keeps its memory from cloth to cloth.
class Separate {
 public:
  bool operator()(const Sheet& sheet, const Held& held, const float* coarse, int h, int w, float* x, bool again);

 private:
  bool cross(const float* x, bool all);
  bool left(const float* x, const int (&triangle)[3]) const;
  void facets(const float* coarse, int h, int w);
  void means(const float* x, const std::vector<int>& held);
  void spread();
  void draw(float* x, const std::vector<float>& goal, float part);

  Meeting meeting_;
  int rows_ = 0, cols_ = 0;
  int pairs_ = 0;                                      // of triangles that crossed where they were last looked for
  bool leave_ = false;                                 // what crosses in the facets
  std::vector<float> facets_, means_, mark_, before_;  // where vertices are drawn to, what part of the way
  std::vector<float> kept_;                            // positions, before they are put into the facets
};

// Marks the vertices of triangles that cross and are not to be left so, of all or of those near vertices that moved
// since the last time or were marked; whether there are some.
bool Separate::cross(const float* x, bool all) {
  const int n = rows_ * cols_;
  lanes<MeetLanes>().find(meeting_, x, mark_.data(), all);
  std::fill(mark_.begin(), mark_.end(), 0.0f);
  bool found = false;
  pairs_ = 0;
  for (const MeetingCells& cells : meeting_.cells) {
    int at[2][4];
    Vec<double> corners[2][4];
    for (int half = 0; half < 2; ++half) {
      const int* const number = meeting_.number.data() + (half ? cells.second : cells.first);
      for (int q = 0; q < 4; ++q) {
        const int i = at[half][q] = number[q % 2 + q / 2 * meeting_.stride];
        corners[half][q] = {x[i], x[n + i], x[2 * n + i]};
      }
    }
    for (int i = 0; i < 2; ++i)
      for (int j = 0; j < 2; ++j) {
        if (!(cells.triangles >> (2 * i + j) & 1)) continue;
        const int a[3] = {0, i ? 3 : 2, i ? 1 : 3}, b[3] = {0, j ? 3 : 2, j ? 1 : 3};
        bool common = false;
        for (int k = 0; k < 9; ++k) common |= at[0][a[k / 3]] == at[1][b[k % 3]];
        if (common) continue;
        const Vec<double> p[3] = {corners[0][a[0]], corners[0][a[1]], corners[0][a[2]]};
        const Vec<double> q[3] = {corners[1][b[0]], corners[1][b[1]], corners[1][b[2]]};
        if (!cross_each_other(p, minicloth::cross(p[1] - p[0], p[2] - p[0]), q,
                              minicloth::cross(q[1] - q[0], q[2] - q[0])))
          continue;
        const int one[3] = {at[0][a[0]], at[0][a[1]], at[0][a[2]]}, other[3] = {at[1][b[0]], at[1][b[1]], at[1][b[2]]};
        ++pairs_;
        if (left(x, one) && left(x, other)) continue;
        found = true;
        for (int k = 0; k < 3; ++k) mark_[one[k]] = mark_[other[k]] = 1;
      }
  }
  return found;
}

// Whether a triangle is left where it is because it lies in the facets.
bool Separate::left(const float* x, const int (&triangle)[3]) const {
  const int n = rows_ * cols_;
  for (int i : triangle)
    for (int k = 0; k < 3; ++k)
      if (!leave_ || !(std::abs(x[k * n + i] - facets_[k * n + i]) <= kThere)) return false;
  return true;
}

// Where every vertex lies in the facets of the coarse cloth.
void Separate::facets(const float* coarse, int h, int w) {
  const int rows = rows_, cols = cols_, n = rows * cols;
  const bool periodic = meeting_.periodic;
  facets_.resize(3 * n);
  for (int r = 0; r < rows; ++r) {
    const float down = float(r) * float(h - 1) / float(rows - 1);
    const int i = std::min(int(down), h - 2);
    for (int c = 0; c < cols; ++c) {
      const float along = periodic ? float(c) * float(w) / float(cols) : float(c) * float(w - 1) / float(cols - 1);
      const int j = std::min(int(along), periodic ? w - 1 : w - 2), right = j + 1 < w ? j + 1 : 0;
      const float a = down - float(i), b = along - float(j);
      for (int k = 0; k < 3; ++k) {
        const float *const upper = coarse + (k * h + i) * w, *const lower = upper + w;
        const float side = a >= b ? lower[j] : upper[right], more = a >= b ? a - b : b - a;
        facets_[k * n + r * cols + c] =
            upper[j] + more * (side - upper[j]) + std::min(a, b) * (lower[right] - upper[j]);
      }
    }
  }
}

// The means of the vertices around every one that is not held.
void Separate::means(const float* x, const std::vector<int>& held) {
  const int rows = rows_, cols = cols_, n = rows * cols;
  means_.resize(3 * n);
  for (int k = 0; k < 3; ++k)
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < cols; ++c) {
        const float* const at = x + k * n + r * cols;
        const int left = c > 0 ? c - 1 : meeting_.periodic ? cols - 1 : 0;
        const int right = c + 1 < cols ? c + 1 : meeting_.periodic ? 0 : c;
        means_[k * n + r * cols + c] =
            0.25f * (at[left] + at[right] + at[c - (r > 0 ? cols : 0)] + at[c + (r + 1 < rows ? cols : 0)]);
      }
  for (int i : held)
    for (int k = 0; k < 3; ++k) means_[k * n + i] = x[k * n + i];
}

// Marks the rings of vertices around those that are marked.
void Separate::spread() {
  const int rows = rows_, cols = cols_;
  for (int ring = 0; ring < kSpread; ++ring) {
    before_ = mark_;
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < cols; ++c) {
        const int i = r * cols + c;
        float most = 0;
        if (r > 0) most = std::max(most, before_[i - cols]);
        if (r + 1 < rows) most = std::max(most, before_[i + cols]);
        if (c > 0) most = std::max(most, before_[i - 1]);
        if (c + 1 < cols) most = std::max(most, before_[i + 1]);
        mark_[i] = std::max(mark_[i], kLess * most);
      }
  }
}

// Draws vertices by a part of their marks to a goal.
void Separate::draw(float* x, const std::vector<float>& goal, float part) {
  const int n = rows_ * cols_;
  spread();
  for (int i = 0; i < n; ++i)
    for (int k = 0; mark_[i] > 0 && k < 3; ++k) x[k * n + i] += part * mark_[i] * (goal[k * n + i] - x[k * n + i]);
}

bool Separate::operator()(const Sheet& sheet, const Held& held, const float* coarse, int h, int w, float* x,
                          bool again) {
  const int n = sheet.rows * sheet.cols;
  rows_ = sheet.rows, cols_ = sheet.cols;
  meeting_.shape(rows_, cols_, sheet.periodic, sheet.row_length * sheet.col_length);
  mark_.resize(n);
  if (again && leave_) return false;
  leave_ = false;
  for (int round = 0; round < kRounds; ++round) {
    if (!cross(x, round == 0 && !again)) return round > 0;
    if (round == 0 && !again) facets(coarse, h, w), held.put(facets_.data());
    if (round >= kFacets) means(x, held.vertices);
    draw(x, round < kFacets ? facets_ : means_, round < kHalves ? 0.5f : 1.0f);
  }
  if (!cross(x, false)) return true;
  const int pairs = pairs_;
  leave_ = true, kept_.assign(x, x + 3 * n);
  for (int round = 0; round < kLeft && cross(x, false); ++round) draw(x, facets_, 1.0f);
  cross(x, true);
  if (pairs_ > pairs) std::copy(kept_.begin(), kept_.end(), x);
  return true;
}

}  // namespace

bool separate(const Sheet& sheet, const Held& held, const float* coarse, int h, int w, float* x, bool again) {
  thread_local Separate separate;
  return separate(sheet, held, coarse, h, w, x, again);
}

}  // namespace minicloth
