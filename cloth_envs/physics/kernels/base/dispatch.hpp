// One choice of instruction set for all kernels. Every room has tables of functions; its lanes.cpp, compiled once for
// each set, defines them.
#pragma once

namespace minicloth {

// The number of a set in kSets, or of the widest that this processor has; MINICLOTH_INSTRUCTION_SET asks for a lesser.
constexpr const char* const kSets[] = {"baseline", "avx2", "avx512"};
extern const int kSet;

// A room's table of functions for set number `set`.
template <class Table, int set>
const Table& table();

// The table to use.
template <class Table>
const Table& lanes() {
#ifdef MINICLOTH_X86_LEVELS
  if (kSet == 2) return table<Table, 2>();
  if (kSet == 1) return table<Table, 1>();
#endif
  return table<Table, 0>();
}

// Beside a table's declaration: that lanes.cpp defines it.
#define DECLARE_LANES(Table)      \
  template <>                     \
  const Table& table<Table, 0>(); \
  template <>                     \
  const Table& table<Table, 1>(); \
  template <>                     \
  const Table& table<Table, 2>();

// At the end of lanes.cpp: the table of the set that it is compiled for (the build defines SET and its name, LANES).
#define DEFINE_LANES(Table, instance) \
  template <>                         \
  const Table& table<Table, SET>() {  \
    return LANES::instance;           \
  }

}  // namespace minicloth
