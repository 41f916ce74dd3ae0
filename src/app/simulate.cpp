#include "imic3d/app/program.hpp"
namespace imic3d::app { void simulate(const Communicator&, const CommandOptions&) {} }
