#include "imic3d/app/program.hpp"
namespace imic3d::app { void report(const Communicator&, const CommandOptions&) {} }
