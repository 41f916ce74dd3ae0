#include "imic3d/app/program.hpp"
namespace imic3d::app { void check(const Communicator&, const CommandOptions&) {} }
