// A rectangle of the web of the "D" specimen GT4, below its slot, in the axes of gt4.geo [mm]: inside the specimen for a camera that is taken
// to look straight at it, too.
DefineConstant[ size = {1.5, Name "element size [mm]"} ];
SetFactory("Built-in");
Point(1) = {-16, -15, 0};
Point(2) = {16, -15, 0};
Point(3) = {16, 7.5, 0};
Point(4) = {-16, 7.5, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Transfinite Curve{1, 3} = Round(32 / size) + 1;
Transfinite Curve{2, 4} = Round(22.5 / size) + 1;
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Surface{1};
Recombine Surface{1};
Physical Surface("specimen") = {1};
Physical Curve("left") = {4};
Physical Curve("right") = {2};
