// What pulls cloths along with coarser ones that were computed before.
#pragma once
#include <cstddef>
#include <vector>

#include "../sheet/cubic.hpp"
#include "core.hpp"

namespace minicloth {

// Linear interpolation along a side: of every fine place the coarse ones around it, and how far on it lies between
// them.
struct Linear {
  int coarse;
  std::vector<int> left, right;
  std::vector<double> share;
  Linear(const double* weights, int fine, int coarse);  // (fine, coarse), two a row at most
  // The fine place that is the coarse one `at`, -1 for none.
  int shared(int at) const;
};

struct Tracking {
  Linear down, across;   // rows and columns
  bool means;            // the fine cloth's means around coarse vertices follow, else the vertices that both share
  double rate, damping;  // of the springs that pull: 1/s, over the critical one
  double levels;         // how much of the coarse sheet's own forces acts on the shared vertices as well
  // Where the means or shared vertices y are to be, q, during a frame: (B, 3, h, w) [m, m per frame]. What they are
  // accelerated by is w^2 (q - y) + 2 z w (q' - y').
  std::vector<Cubic> paths;
  double pull(const Cubic& path, double s, double frame_dt, double y, double speed) const {
    return rate * (rate * (path.position(s) - y) + 2 * damping * (path.velocity(s) / frame_dt - speed));
  }
};

// Means of the cloths in the lanes, weighted by area and by the hats of linear interpolation. What they are accelerated
// by is spread by the same hats, and held for a few times as long as slow forces.
template <class T>
class PullMeans {
 public:
  PullMeans(const Tracking& tracking, const Sheet& sheet, const Strips<T>& strips,
            const std::vector<Material>& materials, const std::vector<std::size_t>& members, const Substeps& substeps);
  // Adds forces [N] to the slow ones, which were just computed in substep `k`.
  void step(const Fields<T>& f, int k);

 private:
  struct Side {
    Linear line;
    std::vector<T> size;  // of every fine place, what it stands for [m]
  };
  struct Lane {
    int cloth, row;  // -1 where there is none
  };
  Lane lane(int row, int l) const;
  void mean(const T* field, std::vector<T>& to);
  void spread();

  const Tracking& tracking_;
  const Strips<T>& strips_;
  const Side rows_, cols_;  // of the strips, which may be turned
  const int count_, held_;
  const double frame_dt_;
  std::vector<double> densities_;       // of the cloths [kg/m^2]
  std::vector<const Cubic*> paths_;     // of every number of coarse_
  std::vector<T> weight_;               // of means, over their sums
  std::vector<T> x_, v_, past_, pull_;  // of cloths, coarse rows and columns: 3 numbers
  std::vector<T> lines_;                // of cloths and their rows, coarse columns: the same
  Plane<T> row_, force_;                // a row's coarse columns; a field
};

// Shared vertices of one cloth, in every substep, with springs, dashpots and bending of the coarse sheet between them.
template <class T>
class PullShared {
 public:
  PullShared(const Tracking& tracking, const Sheet& sheet, const Strips<T>& strips, const Material& material,
             std::size_t member, int lane, int count);
  // Adds the forces [N] of substep `k` to the slow ones: `fresh` ones, or those of the substep before, with its own.
  void step(const Fields<T>& f, int k, bool fresh);

 private:
  void add(const Fields<T>& f, T sign) const;
  void add_springs(int i, int j, int n, double stiffness, double length);
  void add_differences(const std::vector<int>& at, const std::vector<double>& signs, int n, double stiffness);
  void add_sheet();

  const Tracking& tracking_;
  const Material material_;
  const Cubic* const paths_;
  const int rows_, cols_, width_, count_;
  const bool periodic_;
  const double frame_dt_, row_length_, col_length_;  // s; m, of the coarse grid
  std::vector<int> places_;                          // elements of the vertices
  Plane<T> mass_, x_, v_, force_, row_;              // (3, h, w) but for mass_ (h, w); a row of work
};

}  // namespace minicloth
