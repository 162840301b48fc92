// What draws fine cloths on a card, run here thread by thread. LANES names the namespace.
#define LANES emulated
#define MINICLOTH_SCALAR
#include <nanobind/nanobind.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "../module.hpp"
#include "fine.hpp"

namespace nb = nanobind;

namespace minicloth {

extern const char* const kFineText;

namespace {

FineSheet fine_sheet_of(const nb::bytes& bytes) {
  FineSheet sheet;
  if (bytes.size() != sizeof sheet) throw nb::value_error("the bytes are not a FineSheet of gpu/fine_terms.hpp");
  std::memcpy(&sheet, bytes.c_str(), sizeof sheet);
  for (int l = 0; l <= sheet.layers; ++l)
    if (sheet.widths[l] > LANES::kMostWide) throw nb::value_error("a layer may have 252 numbers");
  return sheet;
}

}  // namespace

void bind_drawn(nb::module_& m) {
  m.def(
      "fine_text", [] { return kFineText; }, "What a card compiles to draw fine cloths, but for what macros tell it.");
  m.def(
      "fine_memory",
      [](nb::bytes sheet, int cells, int cloths) { return LANES::Drawn::bytes(fine_sheet_of(sheet), cells, cloths); },
      nb::arg("sheet"), nb::arg("cells"), nb::arg("cloths"),
      "Memory that a block shares to draw some cloths of a FineSheet, of which a network sees `cells` [bytes].");
  m.def(
      "emulate_fine",
      [](nb::bytes sheet, const std::vector<std::uintptr_t>& fields, bool backwards) {
        const FineSheet s = fine_sheet_of(sheet);
        FineBatch batch;
        if (fields.size() * sizeof(void*) != sizeof batch)
          throw nb::value_error("the fields are not as many as FineBatch of gpu/fine_terms.hpp has");
        std::memcpy(&batch, fields.data(), sizeof batch);
        nb::gil_scoped_release release;
        const int cells = batch.counts[LANES::kCells];
        std::vector<LANES::Four> memory(LANES::Drawn::bytes(s, cells, LANES::kCloths) / sizeof(LANES::Four) + 1);
        LANES::Crew crew{backwards};
        for (std::size_t first = 0; first < batch.members; first += LANES::kCloths) {
          std::memset(memory.data(), 0xff, memory.size() * sizeof memory[0]);  // NaN, as emulate.cpp
          float* const spare = s.spare ? batch.said + 3 * LANES::kSaid * cells * first : nullptr;
          const LANES::Drawn drawn(s, reinterpret_cast<unsigned char*>(memory.data()), spare);
          LANES::fine(s, batch, first, drawn, crew);
        }
      },
      nb::arg("sheet"), nb::arg("fields"), nb::arg("backwards"),
      "Fine cloths as a card draws them: a FineSheet, and the addresses that a FineBatch holds. The threads take "
      "turns, the last first if `backwards`.");
}

}  // namespace minicloth
