// P-ADMM (Overby et al. 2017): frames for a batch of cloths, the global step by fast diagonalisation.
#pragma once
#include <memory>
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"
#include "../sheet/air.hpp"
#include "../sheet/bodies.hpp"
#include "../sheet/sheet.hpp"

namespace minicloth {

// An orthogonal basis of even and odd vectors on n places: the first half of each, folded about the middle.
template <class T>
struct Fold {
  int n, even, odd;                               // even = ceil(n / 2), odd = floor(n / 2)
  Plane<T> to_even, to_odd, from_even, from_odd;  // (place, mode) and (mode, place), rows padded
  Plane<T> all;                                   // (place, mode) of the whole basis, rows of n
  Fold(int n, const double* basis);
};

// A material, and the matrix of its steps: eigenvalues, and what keeps the held vertices where they are.
template <class T>
struct System {
  Material material;
  Plane<T> inverse;  // 1 / eigenvalue, (modes of rows, modes of columns), rows of Admm::line_
  // Inverse of the held vertices' Green function with 1 / stiffness of soft ones added, (3 axes, p, padded p).
  Plane<T> capacitance;
};

// What the local step needs: w^2 of springs, bending and twist (N/m, N m, N/m), 1 / (1 + weight), kg/m^2/s^2.
template <class T>
struct LocalTerms {
  T stretch, shear, bend, twist_along, twist_down, twist_diagonal, shrink, inertia;
};

// One plane for each class of edges (along, down, right, left) and axis.
template <class T>
struct EdgePlanes {
  T* p[4][3];
};

template <class T>
struct AdmmLanes {
  // Rest lengths (L + a |d|) / (1 + a) of all edges at x.
  void (*rest)(const Geometry<T>&, T a, T* const (&x)[3], T* const (&rest)[4]);
  // Updates the edges' u at x and writes the residual of the global step.
  void (*local)(const Geometry<T>&, const LocalTerms<T>&, const T* area, T* const (&goal)[3], T* const (&x)[3],
                const EdgePlanes<T>& u, T* const (&rest)[4], T* const (&tail)[9], T* const (&residual)[3]);
  void (*air)(const Geometry<T>&, const AirTerms<T>&, const Planes<T>& in, const Cells<T>& out);
  // c (m, n) = a (m, k) b (k, n), or c += ; a's element (i, j) lies at i * row + j * col, n whole vectors.
  void (*multiply)(int m, int k, int n, const T* a, int row, int col, const T* b, int ldb, T* c, int ldc);
};
DECLARE_LANES(AdmmLanes<float>)
DECLARE_LANES(AdmmLanes<double>)

// Scratch of one thread.
template <class T>
struct AdmmWork;

template <class T>
class Admm {
 public:
  // Bases: columns are the eigenvectors of the grid's Laplacians along rows' and columns' direction, even ones first.
  Admm(Sheet sheet, int substeps, int iterations, double weight, const double* row_basis, const double* col_basis);
  // From eigenvalues (H, W) in the bases' order and the held vertices' inverse Green function (3, p, p).
  System<T> system(const Material& material, const double* eigenvalues, const double* capacitance) const;
  using Systems = std::vector<std::shared_ptr<const System<T>>>;  // of each member
  void advance(const std::vector<Frame<T>>& frames, const Systems& systems, int threads) const;
  // One global step alone: right-hand sides and solutions (3, H, W); held vertices stay 0.
  void solve(const System<T>& system, const T* right, T* x) const;
  const Sheet& sheet() const { return sheet_; }

 private:
  void advance(const Frame<T>& frame, const System<T>& system) const;
  AdmmWork<T>& scratch() const;
  // x += A^-1 residual at vertices that are not held.
  void correct(const System<T>& system, AdmmWork<T>& work, T* const (&x)[3]) const;
  void hold(const System<T>& system, AdmmWork<T>& work) const;
  // Contact: which vertices may touch in this step; forces on them; what these do to x; at last out of the bodies.
  void approach(const std::vector<BodyStep<T>>& bodies, AdmmWork<T>& work) const;
  void push(const std::vector<BodyStep<T>>& bodies, const LocalTerms<T>& terms, AdmmWork<T>& work) const;
  void settle(const System<T>& system, AdmmWork<T>& work) const;
  void project(const std::vector<BodyStep<T>>& bodies, AdmmWork<T>& work) const;

  Sheet sheet_;
  Geometry<T> geometry_;
  int substeps_, iterations_;
  double weight_;
  Fold<T> rows_, cols_;
  int line_, width_;            // of one axis, and of three, in a row of the transforms
  std::vector<int> held_rows_;  // distinct rows of the held vertices, and which of them each is in
  std::vector<int> held_row_of_;
  Plane<T> held_basis_;    // (held rows, modes)
  Plane<T> area_;          // m^2, 0 in ghosts
  std::vector<int> free_;  // places of the vertices that are not held firmly
  const long id_;          // of this solver among all
};

}  // namespace minicloth
