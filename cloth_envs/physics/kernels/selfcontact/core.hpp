// Contact of a cloth with itself, in substeps of the explicit solver.
#pragma once
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
  struct Parts {  // elements of a field: a vertex and a triangle, or two edges
    std::vector<int> at[4];
    int count = 0;
    void clear();
    void add(int a, int b, int c, int d);
    void close();  // with whole vectors behind
  };
  bool strayed() const;
  void search();
  void resolve(const Parts& parts, bool edges, T reach, int steps);

  Sweep<T> sweep_;
  Parts vertices_, edges_;
  const Strips<T>* strips_ = nullptr;
  Fields<T> f_;
  int member_ = 0, since_ = 0, last_ = 0;  // steps since the last search, since contact was last resolved
  T layer_ = 0, friction_ = 0, h_ = 0, damping_ = 0;
  double cell_area_ = 1;
  Plane<T> x0_, v0_;          // fields at the last search
  std::vector<T> mobility_;   // of elements: 1 / area, 0 where firmly held
  std::vector<std::uint16_t> bits_;
  std::vector<int> found_;
};

struct SelfStats { double search = 0, resolve = 0, drift = 0; long searches = 0, checks = 0, frames = 0, vt = 0, ee = 0, hits = 0, blocks = 0, cells = 0, moved = 0; };
extern SelfStats self_stats;
extern double self_tune[16];

}  // namespace minicloth
