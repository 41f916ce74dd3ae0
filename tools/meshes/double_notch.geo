// Flat plate with a round notch in either side, one higher than the other, loaded along y: quadrilaterals. Origin between
// the notches, lengths in mm. Groups: top, bottom, sides (edges), specimen (cells).
//   gmsh -2 -setnumber length 24 -format msh22 double_notch.geo -o notched.msh
DefineConstant[ width = 20 ];        // of the plate, along x
DefineConstant[ length = 24 ];       // of the region that is meshed, along y
DefineConstant[ radius = 3 ];        // of the notches
DefineConstant[ offset = 2 ];        // of the left notch upwards, of the right one downwards
DefineConstant[ size_notch = 0.8 ];  // of the elements at the notches
DefineConstant[ size_far = 2 ];      // of the elements far away

w = width / 2;
h = length / 2;
If (radius <= 0 || radius >= w || radius + offset >= h || offset < 0 || size_notch <= 0 || size_far <= 0)
  Error("double_notch: sizes > 0 and notches within the plate, please");
  Exit;
EndIf
Point(1) = {-w, -h, 0};               Point(2) = {w, -h, 0};             Point(3) = {w, -offset - radius, 0};
Point(4) = {w - radius, -offset, 0};  Point(5) = {w, -offset + radius, 0};
Point(6) = {w, h, 0};                 Point(7) = {-w, h, 0};             Point(8) = {-w, offset + radius, 0};
Point(9) = {-w + radius, offset, 0};  Point(10) = {-w, offset - radius, 0};
Point(11) = {w, -offset, 0};          Point(12) = {-w, offset, 0};
Line(1) = {1, 2};         Line(2) = {2, 3};         Circle(3) = {3, 11, 4};   Circle(4) = {4, 11, 5};
Line(5) = {5, 6};         Line(6) = {6, 7};         Line(7) = {7, 8};         Circle(8) = {8, 12, 9};
Circle(9) = {9, 12, 10};  Line(10) = {10, 1};
Curve Loop(1) = {1:10};
Plane Surface(1) = {1};

// Triangles of twice the size, each cut into three quadrilaterals.
Field[1] = Distance;
Field[1].CurvesList = {3, 4, 8, 9};
Field[1].NNodesByEdge = 100;
Field[2] = Threshold;
Field[2].IField = 1;
Field[2].LcMin = 2 * size_notch;
Field[2].LcMax = 2 * size_far;
Field[2].DistMin = 0.5;
Field[2].DistMax = 6;
Background Field = 2;
Mesh.CharacteristicLengthExtendFromBoundary = 0;
Mesh.CharacteristicLengthFromPoints = 0;
Mesh.Algorithm = 6;
Mesh.RecombineAll = 1;
Mesh.SubdivisionAlgorithm = 1;
Mesh.SecondOrderIncomplete = 1;

Physical Curve("bottom") = {1};
Physical Curve("top") = {6};
Physical Curve("sides") = {2:5, 7:10};
Physical Surface("specimen") = {1};
