#include "imic3d/app/program.hpp"
namespace imic3d::app { void dic(const Communicator&, const CommandOptions&) {} }
