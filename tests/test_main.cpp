// Runs the tests of one room on every rank of MPI_COMM_WORLD; a failure on any rank fails the program.
#include <gtest/gtest.h>
#include <mpi.h>

#if __has_include(<petsc.h>)
#include <petsc.h>
#endif

int main(int argc, char** argv) {
  ::testing::InitGoogleTest(&argc, argv);
  int provided = 0;
  MPI_Init_thread(&argc, &argv, MPI_THREAD_FUNNELED, &provided);
#ifdef PETSC_VERSION_MAJOR
  if (PetscInitialize(&argc, &argv, nullptr, nullptr) != 0) return 1;
#endif
  int rank = 0;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  if (rank != 0) {
    auto& listeners = ::testing::UnitTest::GetInstance()->listeners();
    delete listeners.Release(listeners.default_result_printer());
  }
  int failed = RUN_ALL_TESTS();
  MPI_Allreduce(MPI_IN_PLACE, &failed, 1, MPI_INT, MPI_MAX, MPI_COMM_WORLD);
#ifdef PETSC_VERSION_MAJOR
  PetscFinalize();
#endif
  MPI_Finalize();
  return failed;
}
