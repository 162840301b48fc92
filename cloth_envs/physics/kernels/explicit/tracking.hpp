// What pulls a cloth along with a coarser one that was computed before.
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
  // Where the means or shared vertices are to be during a frame: of every cloth (3, h, w) [m, m per frame].
  std::vector<Cubic> paths;
};

// Of one cloth in a frame, accelerations a = w^2 (q - y) + 2 z w (q' - y') to where y is to be, q: of means, which are
// weighted by area and bilinear hats, spread by the same hats and held for several times as long as slow forces; else
// of shared vertices, in every substep, beside springs, dashpots and bending of the coarse sheet between them.
template <class T>
class Pull {
 public:
  Pull(const Tracking& tracking, const Sheet& sheet, const Strips<T>& strips, const Material& material,
       std::size_t member, int lane, const Substeps& substeps);
  // Adds the forces [N] of substep `k` to the slow ones: `fresh` ones, or those of the substep before, with its own.
  void step(const Fields<T>& f, int k, bool fresh);

 private:
  void pull_means(const Fields<T>& f, int k);
  void pull_shared(const Fields<T>& f, int k);
  void mean(const T* field, Plane<T>& to);
  void accelerate(double s);
  void add_springs(int i, int j, int n, double stiffness, double length);
  void add_differences(const std::vector<int>& at, const std::vector<double>& signs, int n, double stiffness);
  void add_sheet();

  const Tracking& tracking_;
  const Strips<T>& strips_;
  const Material material_;
  const Cubic* paths_;
  const int lane_, rows_, cols_, count_, held_;
  const bool periodic_;
  const double h_, row_length_, col_length_;  // s; m, of the coarse grid
  int every_ = 1;                             // how many times as long as slow forces those of means are held
  std::vector<int> places_;                   // elements of the fine cloth's vertices, or of the shared ones
  Plane<T> down_, across_, area_;             // of the fine rows and columns [m], of every place [m^2]
  Plane<T> weight_;                           // of means, over their sums
  Plane<T> x_, v_, past_, pull_, force_;      // of coarse vertices (3, h, w); of places (3, n) [N]
  Plane<T> row_;
};

}  // namespace minicloth
