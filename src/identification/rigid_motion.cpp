// What the simulation leaves open of the rigid motion, fitted to the measured displacement.
#include <Eigen/Dense>
#include <Eigen/Geometry>

#include "imic3d/core/linear.hpp"
#include "imic3d/identification/gauss_newton.hpp"

namespace imic3d::identification {

Eigen::MatrixXd rigid_modes(const Specimen& specimen, Control control, const Eigen::VectorXd& displacement) {
  const bool in_plane = control == Control::force, through = control != Control::images && specimen.out_of_plane();
  const Eigen::Index first = in_plane ? 3 : 0;
  Eigen::MatrixXd modes = Eigen::MatrixXd::Zero(displacement.size(), first + (through ? 3 : 0));
  // where a rotation moves the ends least that drive the simulation
  const double middle = specimen.surface.mesh.nodes.col(2).mean();
  for (const Face& face : specimen.faces)
    for (Eigen::Index i = 0; i < face.nodes(); ++i) {
      const Eigen::Index row = face.first_unknown + face.components * i;
      Eigen::Vector3d x = face.surface.mesh.nodes.row(i).transpose();
      for (int a = 0; a < face.components; ++a) x[a] += displacement[row + a];
      if (in_plane) {
        modes.row(row).head<3>() << 1.0, 0.0, -x[1];
        modes.row(row + 1).head<3>() << 0.0, 1.0, x[0];
      }
      if (!through) continue;
      const double z = x[2] - middle;
      modes(row, first + 2) = z;
      modes(row + 1, first + 1) = -z;
      if (face.components == 3) modes.row(row + 2).tail<3>() << 1.0, x[1], -x[0];
    }
  return modes;
}

void fit_rigid_motion(const Specimen& specimen, Control control, const Eigen::SparseMatrix<double>& M,
                      const Eigen::MatrixXd& dic, Path& path) {
  const bool through = specimen.out_of_plane(), in_plane = control == Control::force;
  const Eigen::Vector3d pivot(0.0, 0.0, specimen.surface.mesh.nodes.col(2).mean());
  for (int t = 0; t < path.frames; ++t) {
    for (int iteration = 0; iteration < (through ? 3 : 1); ++iteration) {
      const Eigen::MatrixXd modes = rigid_modes(specimen, control, path.surface.col(t));
      if (modes.cols() == 0) return;
      const Eigen::MatrixXd weighted = M * modes;
      const Eigen::VectorXd motion =
          solve_symmetric(modes.transpose() * weighted, weighted.transpose() * (dic.col(t) - path.surface.col(t)));
      if (!through) {
        path.surface.col(t) += modes * motion;
        continue;
      }
      const Eigen::Vector3d leaning = motion.tail<3>();  // along z, about x and y
      const Eigen::Vector3d turned(leaning[1], leaning[2], in_plane ? motion[2] : 0.0),
          moved(in_plane ? motion[0] : 0.0, in_plane ? motion[1] : 0.0, leaning[0]);
      const Eigen::Matrix3d R = Eigen::AngleAxisd(turned.norm(), turned.stableNormalized()).toRotationMatrix();
      for (const Face& face : specimen.faces)
        for (Eigen::Index i = 0; i < face.nodes(); ++i) {
          auto u = path.surface.col(t).segment(face.first_unknown + face.components * i, face.components);
          Eigen::Vector3d x = face.surface.mesh.nodes.row(i).transpose();
          for (int a = 0; a < face.components; ++a) x[a] += u[a];
          const Eigen::Vector3d change = (R - Eigen::Matrix3d::Identity()) * (x - pivot) + moved;
          for (int a = 0; a < face.components; ++a) u[a] += change[a];
        }
    }
  }
}

Eigen::MatrixXd without_leaning(const Specimen& specimen, Eigen::MatrixXd displacement) {
  if (!specimen.out_of_plane()) return displacement;
  for (auto u : displacement.colwise()) {
    // The plane z = a x + b y + c of each face, a and b common to those that are seen in space.
    Eigen::Matrix2d squares = Eigen::Matrix2d::Zero();
    Eigen::Vector2d slope = Eigen::Vector2d::Zero();
    Eigen::Vector3d pivot = Eigen::Vector3d::Zero();
    Eigen::Index faces = 0;
    for (const Face& face : specimen.faces) {
      if (face.components != 3) continue;
      const auto moved = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>(
          u.data() + face.first_unknown, face.nodes(), 3);
      const Eigen::MatrixXd x = face.surface.mesh.nodes + moved;
      const Eigen::RowVector3d middle = x.colwise().mean();
      const Eigen::MatrixXd from_middle = x.leftCols(2).rowwise() - middle.head<2>();
      squares += from_middle.transpose() * from_middle;
      slope += from_middle.transpose() * moved.col(2);
      pivot += middle.transpose(), ++faces;
    }
    slope = squares.ldlt().solve(slope).eval();
    pivot /= static_cast<double>(faces);
    const Eigen::Matrix3d back =
        Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d(-slope[0], -slope[1], 1.0), Eigen::Vector3d::UnitZ())
            .toRotationMatrix();
    for (const Face& face : specimen.faces)
      for (Eigen::Index i = 0; i < face.nodes(); ++i) {
        auto own = u.segment(face.first_unknown + face.components * i, face.components);
        Eigen::Vector3d x = face.surface.mesh.nodes.row(i).transpose();
        for (int a = 0; a < face.components; ++a) x[a] += own[a];
        if (face.components == 2) x[2] += slope.dot(x.head<2>() - pivot.head<2>());
        const Eigen::Vector3d change = (back - Eigen::Matrix3d::Identity()) * (x - pivot);
        for (int a = 0; a < face.components; ++a) own[a] += change[a];
      }
  }
  return displacement;
}

}  // namespace imic3d::identification
