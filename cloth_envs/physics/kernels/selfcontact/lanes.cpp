// Compiled once per instruction set; LANES names the namespace.
#include "cells.hpp"
#include "look.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
const NearLanes<T> instance = {boxes<T>, blocks<T>, cells<T>, parts<T>, stray<T>, look<T>};

}  // namespace
}  // namespace LANES

DEFINE_LANES(NearLanes<float>, instance<float>)
DEFINE_LANES(NearLanes<double>, instance<double>)

}  // namespace minicloth
