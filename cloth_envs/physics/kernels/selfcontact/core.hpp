// Contact of a cloth with itself, in substeps of the explicit solver.
#pragma once
#include <array>
#include <vector>

#include "../explicit/core.hpp"
#include "near.hpp"

namespace minicloth {

// Vertices that lie nearer than a layer's thickness to a triangle, and edges that lie nearer than a part of it to
// another, are kept apart by impulses (as Bridson et al. 2002, section 7.2, but without springs): they come no closer,
// slide against friction, and are moved apart a little. Both are equal and opposite.
template <class T>
class SelfContact {
 public:
  // Of the cloth in lane `member` of `f`, at the start of a frame in steps of h.
  void begin(const Sheet& sheet, const Strips<T>& s, const Fields<T>& f, int member, double h, double damping,
             const std::vector<int>& firm);
  // At the end of a step.
  void step();

 private:
  void get(const T* field, Plane<T>& to) const;
  void search();
  void check();
  void find(bool all);
  void look(bool edges, std::vector<int>& which);
  // Whether they are still nearer than half their reach.
  bool resolve(int part, bool edges, int steps);
  void remember();

  Sweep<T> sweep_;
  // Vertices and triangles, then from edges_ on edges: elements of a field.
  std::vector<std::array<int, 4>> parts_;
  std::vector<std::array<T, 3>> side_;  // of every pair, see NearLanes::look
  std::vector<int> owner_;              // of every pair the pair of blocks that it was found in
  std::vector<int> due_[2][kMostSteps + 1];  // parts of both kinds to look at in so many steps, as a ring
  std::vector<std::pair<int, int>> acts_;
  std::vector<int> touched_;            // parts that were kept apart since the last search
  std::vector<char> known_;             // of elements: whether a pair that begins with it is in sides_
  std::vector<std::pair<std::array<int, 4>, std::array<T, 3>>> sides_;
  int now_ = 0;
  const Strips<T>* strips_ = nullptr;
  Fields<T> f_;
  int member_ = 0, since_ = 0, check_ = 0;  // steps since the last search, when to check
  T layer_ = 0, friction_ = 0, h_ = 0, damping_ = 0, haste_ = 0, most_ = 0;
  double cell_area_ = 1;
  std::vector<T> mobility_;   // of elements: over 1 / the area of an inner vertex, 0 where firmly held
  std::vector<int> corner_[4];  // of every cell: elements of its corners
  std::vector<std::array<std::uint8_t, kParts + 2>> first_;
  std::vector<std::uint8_t> wait_;
};

struct SelfStats { double search = 0, resolve = 0, drift = 0; long searches = 0, checks = 0, frames = 0, vt = 0, ee = 0, hits = 0, blocks = 0, cells = 0, moved = 0; };
extern SelfStats self_stats;
extern double self_tune[16];

}  // namespace minicloth
