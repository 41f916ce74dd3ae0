#include <H5public.h>
#include <fmt/format.h>
#include <mpi.h>
#include <petscversion.h>

#include <Eigen/Core>
#include <opencv2/core/version.hpp>

#include "imic3d/app/program.hpp"
#include "imic3d_revision.hpp"

namespace imic3d::app {

std::string revision() { return IMIC3D_REVISION; }

std::string version_text() {
  char mpi[MPI_MAX_LIBRARY_VERSION_STRING] = {};
  int length = 0;
  MPI_Get_library_version(mpi, &length);
  std::string library(mpi, static_cast<std::size_t>(length));
  library = library.substr(0, library.find(','));
  return fmt::format("imic3d {} (revision {})\nPETSc {}.{}.{}\nMPI {}\nHDF5 {}.{}.{}\nOpenCV {}\nEigen {}.{}.{}\n",
                     IMIC3D_VERSION, IMIC3D_REVISION, PETSC_VERSION_MAJOR, PETSC_VERSION_MINOR, PETSC_VERSION_SUBMINOR,
                     library, H5_VERS_MAJOR, H5_VERS_MINOR, H5_VERS_RELEASE, CV_VERSION, EIGEN_WORLD_VERSION,
                     EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION);
}

}  // namespace imic3d::app
