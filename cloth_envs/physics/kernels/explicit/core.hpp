// The explicit solver: frames of velocity Verlet substeps for a batch of cloths; bending and the air, which change
// slowly, are computed every few of them.
#pragma once
#include <cstdint>
#include <utility>
#include <vector>

#include "../base/dispatch.hpp"
#include "../sheet/bodies.hpp"
#include "../sheet/sheet.hpp"
#include "strips.hpp"

namespace minicloth {

// Fields of Strips, and three rows between which forces wait.
template <class T>
struct Fields {
  T *x, *y, *v;           // positions, those `damping` times the velocity later, velocities
  T* slow;                // forces that are held for some substeps [N]
  T *ahead, *mid, *past;  // positions and velocities that they are computed with; velocities when they last were
  // Rows: what edges from the row above bring, and those of the first row; the air on the row below.
  T *arrive, *first, *low;
};

template <class T>
using Lanes = T[kMostLanes<T>];

// Vectors with vertices that may meet bodies in the next substeps: the element of the first lane, a bit for each such
// lane and for each body, the same for every kBits-th.
constexpr int kBits = 64;
struct Near {
  int at;
  unsigned lanes;
  std::uint64_t bodies;
};

// What a substep needs of every lane's cloth.
template <class T>
struct StepTerms {
  alignas(64) Lanes<T> stretch, shear, damping;           // N/m, N/m, s
  Lanes<T> yields, buckled, buckling, shortened_damping;  // of a shortened spring: see core.cpp
  Lanes<T> accelerate, decay, gravity_kick, dt;           // force/area -> dv, v factor, dv of gravity, s
};

// The same of the slow forces.
template <class T>
struct SlowTerms {
  alignas(64) Lanes<T> bend, twist;             // N m, over a plate's
  Lanes<T> normal, lift, tangential, pressure;  // AirTerms
  Lanes<T> wind[3];                             // m/s
  Lanes<T> later;                               // s, from now to the middle of the time that they are held
  T trend;                                      // of the velocities since `past`, how much will be added by then
};

// A substep without bodies or with them, and the half kick at the end of a frame.
enum class Part { kFree, kBodies, kLast };

template <class T>
struct ExplicitLanes {
  int width;
  // A substep of springs, dampers, gravity, drag, the slow forces and contact with bodies.
  using Step = void (*)(const Strips<T>&, const Fields<T>&, const StepTerms<T>&, const std::vector<BodyLanes<T>>&,
                        const std::vector<Near>&);
  Step step[2][3];  // [simple material][Part]
  // Bending and the air.
  using Slow = void (*)(const Strips<T>&, const Fields<T>&, const SlowTerms<T>&);
  Slow slow[2][2][2];  // [bending][air][pressure]; none for none
  // Which bodies are near for some substeps: see near.hpp.
  void (*near)(const Strips<T>&, const Fields<T>&, const StepTerms<T>&, const std::vector<BodyLanes<T>>&, int,
               std::vector<Near>&);
  // Of the shear of positions, and of velocities: see shear.hpp.
  T (*slant)(int, int, const T*);
  T (*apart)(int, int, const T*);
};
DECLARE_LANES(ExplicitLanes<float>)
DECLARE_LANES(ExplicitLanes<double>)

// How a cloth's frame is cut: substeps, and for how many of them slow forces are held.
struct Substeps {
  int count, held;
  bool operator==(const Substeps& o) const { return count == o.count && held == o.held; }
};

// From substep `first` to the middle of the kicks before `end`, in substeps; a frame's first and last kick are half.
double middle(int first, int end, int count);

struct Tracking;

// How a cloth's frames are cut while it is sheared by no more than each of Explicit's limits, and the speed of
// neighbours over each other above which as by the last [m/s].
struct Cuts {
  std::vector<Substeps> levels;
  double fast;
};

template <class T>
class Explicit {
 public:
  // `sheared` are sines of shear, rising.
  Explicit(Sheet sheet, std::vector<double> sheared);
  // Frames of some cloths, each of its own material. Which of its cuts each takes is found in `levels`: that of its
  // `level` at the frame's start or, where that is higher at the end or it is not finite, of that in another go. How
  // many pairs of its triangles crossed at the start is found in `crossings`, 0 without contact with itself. Results do
  // not depend on threads, nor on which cloths are in a batch. All are pulled along as `tracking` says, null for none.
  void advance(const std::vector<Frame<T>>& frames, const std::vector<Material>& materials,
               const std::vector<Cuts>& cuts, const Tracking* tracking, int threads, int* levels, int* crossings) const;
  // The largest shear of positions (3, H, W), a sine: the mean over the four corners at an inner vertex, as long as
  // edges have their lengths, where those above may count against those below, those to the left against those to the
  // right. Folded edges count for less.
  double shear(const T* x) const;
  // The largest speed of a vertex over its neighbour's along a row or column, of velocities (3, H, W) [m/s].
  double apart(const T* v) const;
  // Which cuts hold: those of the shear, the last where neighbours part at over `fast` [m/s].
  int level(const T* x, const T* v, double fast) const;
  std::size_t levels() const { return sheared_.size(); }
  const Sheet& sheet() const { return sheet_; }

 private:
  // Those of `which`, each with the cuts of its level; the levels at their ends.
  void advance(const std::vector<Frame<T>>& frames, const std::vector<Material>& materials,
               const std::vector<Cuts>& cuts, const Tracking* tracking, int threads,
               const std::vector<std::size_t>& which, const int* levels, int* ends, int* crossings) const;
  // Cloths that are alike in substeps and in whether materials are simple, in the lanes of vectors, or one in bands.
  // Whether all of them are finite then.
  bool advance(const std::vector<Frame<T>>& frames, const std::vector<Material>& materials, const Substeps& substeps,
               const std::vector<std::size_t>& members, const Tracking* tracking, int* crossings) const;
  Sheet sheet_;
  std::vector<double> sheared_;
  Strips<T> bands_, cloths_;
};

}  // namespace minicloth
