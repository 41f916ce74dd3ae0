#pragma once
// Pictures (PNG) to judge a run by: the mesh on the image, residual maps, fields on the mesh.

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "imic3d/io/results_file.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::io {

/// How numbers become colours.
struct ColourScale {
  std::string legend;  ///< what is shown, with its unit, e.g. "residual [sigma]" (ASCII)
  double lower = 0.0;  ///< with upper: the range; chosen from the values if both are equal
  double upper = 0.0;
  bool diverging = true;  ///< blue - grey - red about 0 (range made symmetric); else one hue, dark to light
};

/// Draws the edges of a quad mesh on an image, its contours thicker and its node groups as dots with their names.
/// pixels: [nodes x 2] column, row of each node. Throws InputError if the image cannot be read.
void draw_mesh_on_image(const std::filesystem::path& picture, const std::filesystem::path& image,
                        const mesh::Mesh& quads, std::span<const double> pixels);

/// Draws a map of pixels with a legend. values: [rows x columns]; NaN stays white.
void draw_map(const std::filesystem::path& picture, std::span<const double> values, int columns, int rows,
              const ColourScale& scale);

/// Draws a field on a quad mesh with a legend. positions: [nodes x 2] horizontal, vertical (downwards), any unit;
/// values: one a node (interpolated) or one a cell. The picture is as large as the cells are: a part of them is a zoom.
void draw_field(const std::filesystem::path& picture, const mesh::Mesh& quads, std::span<const double> positions,
                std::span<const double> values, const ColourScale& scale);

/// Draws what a results file has: DIC displacement along the axis in the last frame that has one. Returns the files, in
/// `folder`.
std::vector<std::filesystem::path> draw_pictures(const ResultsFile& file, const std::filesystem::path& folder);

}  // namespace imic3d::io
