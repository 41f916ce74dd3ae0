#include "imic3d/app/program.hpp"

int main(int argc, char** argv) { return imic3d::app::run(argc, argv); }
