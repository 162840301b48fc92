// Contact of a cloth with itself, in substeps of the explicit solver.
#pragma once
#include <array>
#include <utility>
#include <vector>

#include "../explicit/core.hpp"
#include "near.hpp"
#include "untangle.hpp"

namespace minicloth {

// Vertices and triangles, and edges, that lie nearer to each other than a layer are kept apart: they do not go on
// towards each other, slide against friction, and what is missing is made up for little by little. Momentum is kept.
// Contact acts on velocities and moves vertices, as contact with bodies does; no spring is added (section 7 of Bridson,
// Fedkiw & Anderson 2002 has both).
template <class T>
class SelfContact {
 public:
  // Of the cloth in lane `member` of `f`, at the start of a frame of `count` steps.
  void begin(const Sheet& sheet, const Strips<T>& s, const Fields<T>& f, int member, int count, double damping);
  // At the end of a step.
  void step();
  // How many pairs of triangles crossed at the start of the frame.
  int crossings() const { return crossings_; }

 private:
  void get(const T* field, Plane<T>& to) const;
  void search();
  void check();
  void find(bool all);
  void untangle();
  void add(const CellPair& cells, const FirstLooks& looks);
  void remember();
  void look(bool edges, std::vector<int>& which);
  bool resolve(int part, bool edges, int steps, bool first);

  Sweep<T> sweep_;
  Untangle<T> untangle_;
  std::vector<MeetingCells> meet_;  // cells that may cross
  std::vector<FirstLooks> first_;
  std::vector<Close<T>> parts_;
  std::vector<int> due_[2][kMostSteps + 1];  // of both kinds, what to look at in so many steps, as a ring from now_
  std::vector<std::uint8_t> wait_;
  std::vector<std::pair<int, int>> acts_;  // what to keep apart now, and for how many steps
  std::vector<int> touched_;               // what was kept apart since it was found
  std::vector<Close<T>> before_;           // the same of what is found anew, and whether some begin with an element
  std::vector<char> known_;

  const Strips<T>* strips_ = nullptr;
  Fields<T> f_;
  int member_ = 0, now_ = 0, count_ = 0, left_ = 0;  // steps of the frame, and those left
  int since_ = 0, check_ = 0, window_ = 0;           // steps since a search, when to check, to search
  int crossings_ = 0;
  T layer_ = 0, friction_ = 0, h_ = 0, damping_ = 0;
  double cell_area_ = 1;
  std::vector<std::uint8_t> crowd_;  // of elements: in how many pairs that are kept apart now
  std::vector<T> mobility_;          // of elements: 1 / area over that of an inner vertex, 0 where firmly held
  std::vector<int> corner_[4];       // of every cell: elements of its corners
};

}  // namespace minicloth
