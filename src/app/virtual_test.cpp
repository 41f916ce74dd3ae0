#include "imic3d/app/program.hpp"
namespace imic3d::app { void virtual_test(const Communicator&, const CommandOptions&) {} }
