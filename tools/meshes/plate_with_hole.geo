// Flat plate with a central hole, loaded along y: quadrilaterals in blocks, an O-grid around the hole. Origin at the
// hole's centre, lengths in mm. Groups: top, bottom, sides, hole (edges), specimen (cells).
//   gmsh -2 -setnumber width 20 -setnumber length 24 -format msh41 plate_with_hole.geo -o plate.msh
DefineConstant[ width = 20 ];       // of the plate, along x
DefineConstant[ diameter = 5 ];     // of the hole
DefineConstant[ length = 24 ];      // of the region that is meshed, along y
DefineConstant[ size_hole = 0.4 ];  // of the elements at the hole's edge
DefineConstant[ size_far = 1 ];     // of the elements far away

radius = diameter / 2;
half_width = width / 2;
half_length = length / 2;
If (diameter <= 0 || diameter >= 0.9 * width || diameter >= 0.9 * length || size_hole <= 0 || size_far <= 0)
  Error("plate_with_hole: sizes > 0 and a hole smaller than 0.9 times width and length, please");
  Exit;
EndIf

// The square that holds the O-grid: its sides have as many elements as a quarter of the hole, of the far size.
per_quarter = Ceil(Pi * diameter / 4 / size_hole);
square = per_quarter * size_far / 2;
If (square < 1.5 * radius)
  square = 1.5 * radius;
EndIf
limit = half_width;
If (half_length < limit)
  limit = half_length;
EndIf
If (square > 0.85 * limit)
  square = limit;
EndIf

// Lines of the grid of blocks.
xs[] = {-square, square};
If (square < 0.999 * half_width)
  xs[] = {-half_width, -square, square, half_width};
EndIf
ys[] = {-square, square};
If (square < 0.999 * half_length)
  ys[] = {-half_length, -square, square, half_length};
EndIf
nx = #xs[];
ny = #ys[];

grid[] = {};
For j In {0:ny-1}
  For i In {0:nx-1}
    p = newp; Point(p) = {xs[i], ys[j], 0};
    grid[] += p;
  EndFor
EndFor
along_x[] = {};
For j In {0:ny-1}
  For i In {0:nx-2}
    l = newl; Line(l) = {grid[i + nx * j], grid[i + 1 + nx * j]};
    along_x[] += l;
    n = per_quarter;
    If (xs[i] > 0 || xs[i + 1] < 0)
      n = Ceil((xs[i + 1] - xs[i]) / size_far - 1e-6);
    EndIf
    Transfinite Curve {l} = n + 1;
  EndFor
EndFor
along_y[] = {};
For j In {0:ny-2}
  For i In {0:nx-1}
    l = newl; Line(l) = {grid[i + nx * j], grid[i + nx * (j + 1)]};
    along_y[] += l;
    n = per_quarter;
    If (ys[j] > 0 || ys[j + 1] < 0)
      n = Ceil((ys[j + 1] - ys[j]) / size_far - 1e-6);
    EndIf
    Transfinite Curve {l} = n + 1;
  EndFor
EndFor

// The O-grid in the middle block, from the hole outwards.
ci = (nx - 2) / 2;
cj = (ny - 2) / 2;
corner[] = {grid[ci + nx * cj], grid[ci + 1 + nx * cj], grid[ci + 1 + nx * (cj + 1)], grid[ci + nx * (cj + 1)]};
side[] = {along_x[ci + (nx - 1) * cj], along_y[ci + 1 + nx * cj], -along_x[ci + (nx - 1) * (cj + 1)],
          -along_y[ci + nx * cj]};
centre = newp; Point(centre) = {0, 0, 0};
on_hole[] = {};
For k In {0:3}
  p = newp; Point(p) = {radius * Cos(Pi * (2 * k - 3) / 4), radius * Sin(Pi * (2 * k - 3) / 4), 0};
  on_hole[] += p;
EndFor
reach = (square * (1 + Sqrt(2)) / 2) - radius;  // mean distance from the hole to the square
far = 2 * square / per_quarter;                 // element size there
radial = Ceil(2 * reach / (size_hole + far) - 1e-6);
growth = 1;
If (radial > 1)
  growth = (far / size_hole) ^ (1 / (radial - 1));
EndIf
spoke[] = {};
arc[] = {};
For k In {0:3}
  l = newl; Line(l) = {on_hole[k], corner[k]};
  Transfinite Curve {l} = radial + 1 Using Progression growth;
  spoke[] += l;
  l = newl; Circle(l) = {on_hole[k], centre, on_hole[(k + 1) % 4]};
  Transfinite Curve {l} = per_quarter + 1;
  arc[] += l;
EndFor

blocks[] = {};
For k In {0:3}
  loop = newll; Curve Loop(loop) = {spoke[k], side[k], -spoke[(k + 1) % 4], -arc[k]};
  s = news; Plane Surface(s) = {loop};
  blocks[] += s;
EndFor
For j In {0:ny-2}
  For i In {0:nx-2}
    If (i != ci || j != cj)
      loop = newll;
      Curve Loop(loop) = {along_x[i + (nx - 1) * j], along_y[i + 1 + nx * j], -along_x[i + (nx - 1) * (j + 1)],
                          -along_y[i + nx * j]};
      s = news; Plane Surface(s) = {loop};
      blocks[] += s;
    EndIf
  EndFor
EndFor
Transfinite Surface {blocks[]};
Recombine Surface {blocks[]};

bottom[] = {};
top[] = {};
For i In {0:nx-2}
  bottom[] += along_x[i];
  top[] += along_x[i + (nx - 1) * (ny - 1)];
EndFor
sides[] = {};
For j In {0:ny-2}
  sides[] += along_y[nx * j];
  sides[] += along_y[nx - 1 + nx * j];
EndFor
Physical Surface("specimen", 1) = {blocks[]};
Physical Curve("top", 2) = {top[]};
Physical Curve("bottom", 3) = {bottom[]};
Physical Curve("hole", 4) = {arc[]};
Physical Curve("sides", 5) = {sides[]};
