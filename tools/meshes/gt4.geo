// The visible speckled part of the "D" specimen GT4, about 100 mm x 50 mm: a strip above a D-shaped slot, the web below it.
// Outline: edges of the image of camera 0, 3 pixels inwards, put on the plane that patches seen by both cameras give
// (calibration of the rig, millimetres). x along the slot's straight edge, y up, z to the cameras.
DefineConstant[ size = {2.0, Name "element size [mm]"} ];
SetFactory("Built-in");
Mesh.CharacteristicLengthMax = 2 * size;
Mesh.Algorithm = 6;
Mesh.RecombinationAlgorithm = 1;
Mesh.SubdivisionAlgorithm = 1;  // all quadrilaterals, of half the size
Mesh.RecombineAll = 1;
Mesh.Smoothing = 20;

// Left edge, up; the left leg; along the notch; the right leg; right edge, down.
Point(1) = {-52.2, -7.0, 0, 2 * size};
Point(2) = {-52.2, 29.2, 0, 2 * size};
Point(3) = {-37.4, 29.2, 0, 2 * size};
Point(4) = {-36.1, 28.0, 0, 2 * size};
Point(5) = {-34.2, 27.4, 0, 2 * size};
Point(6) = {30.2, 27.5, 0, 2 * size};
Point(7) = {31.8, 28.2, 0, 2 * size};
Point(8) = {32.6, 29.2, 0, 2 * size};
Point(9) = {47.5, 29.2, 0, 2 * size};
Point(10) = {47.5, -7.5, 0, 2 * size};
Line(1) = {1, 2};
Line(2) = {2, 3};
Spline(3) = {3, 4, 5};
Line(4) = {5, 6};
Spline(5) = {6, 7, 8};
Line(6) = {8, 9};
Line(7) = {9, 10};
// The lower edge, from right to left.
Point(11) = {45.4, -5.9, 0, 2 * size};
Point(12) = {43.1, -5.65, 0, 2 * size};
Point(13) = {41.05, -5.9, 0, 2 * size};
Point(14) = {39.4, -6.8, 0, 2 * size};
Point(15) = {33.9, -10.25, 0, 2 * size};
Point(16) = {28.4, -13.25, 0, 2 * size};
Point(17) = {21.2, -16.15, 0, 2 * size};
Point(18) = {14.1, -18.4, 0, 2 * size};
Point(19) = {6.0, -19.8, 0, 2 * size};
Point(20) = {-2.4, -20.35, 0, 2 * size};
Point(21) = {-11.0, -19.8, 0, 2 * size};
Point(22) = {-18.35, -18.55, 0, 2 * size};
Point(23) = {-25.6, -16.35, 0, 2 * size};
Point(24) = {-32.4, -13.6, 0, 2 * size};
Point(25) = {-38.2, -10.6, 0, 2 * size};
Point(26) = {-43.7, -7.15, 0, 2 * size};
Point(27) = {-46.0, -5.8, 0, 2 * size};
Point(28) = {-48.3, -5.4, 0, 2 * size};
Point(29) = {-50.5, -5.75, 0, 2 * size};
Spline(8) = {10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 1};
Curve Loop(1) = {1, 2, 3, 4, 5, 6, 7, 8};

// The slot.
Point(40) = {-25.3, 23.0, 0, 2 * size};
Point(41) = {20.55, 23.0, 0, 2 * size};
Point(42) = {21.85, 22.45, 0, 2 * size};
Point(43) = {22.65, 21.4, 0, 2 * size};
Point(44) = {22.85, 20.1, 0, 2 * size};
Point(45) = {22.4, 18.8, 0, 2 * size};
Point(46) = {20.8, 17.4, 0, 2 * size};
Point(47) = {16.9, 14.85, 0, 2 * size};
Point(48) = {12.0, 12.5, 0, 2 * size};
Point(49) = {4.6, 10.3, 0, 2 * size};
Point(50) = {-4.0, 9.7, 0, 2 * size};
Point(51) = {-10.9, 10.45, 0, 2 * size};
Point(52) = {-18.2, 13.0, 0, 2 * size};
Point(53) = {-23.3, 15.7, 0, 2 * size};
Point(54) = {-26.7, 17.95, 0, 2 * size};
Point(55) = {-27.7, 19.2, 0, 2 * size};
Point(56) = {-27.9, 20.3, 0, 2 * size};
Point(57) = {-27.5, 21.8, 0, 2 * size};
Point(58) = {-26.6, 22.65, 0, 2 * size};
Line(10) = {40, 41};
Spline(11) = {41, 42, 43, 44, 45, 46, 47, 48, 49, 50, 51, 52, 53, 54, 55, 56, 57, 58, 40};
Curve Loop(2) = {10, 11};

Plane Surface(1) = {1, 2};
Physical Surface("specimen") = {1};
Physical Curve("left") = {1};
Physical Curve("right") = {7};
