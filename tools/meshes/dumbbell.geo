// Flat dumbbell, loaded along x: quadrilaterals in blocks. Origin at the centre of the waist, lengths in mm. The fillets
// begin tangent to the waist and end at a corner with the ends. Groups: left, right, sides (edges), specimen (cells).
//   gmsh -2 -setnumber waist_width 12 -setnumber region 34 -format msh41 dumbbell.geo -o dumbbell.msh
DefineConstant[ length = 80 ];        // overall
DefineConstant[ end_width = 20 ];
DefineConstant[ waist_width = 12 ];
DefineConstant[ waist_length = 12 ];  // of the parallel part
DefineConstant[ radius = 20 ];        // of the fillets
DefineConstant[ region = 34 ];        // length that is meshed, about the centre
DefineConstant[ size = 1 ];           // of the elements

rise = (end_width - waist_width) / 2;
If (rise <= 0 || rise > radius || waist_width <= 0 || waist_length <= 0 || size <= 0 || region > length)
  Error("dumbbell: sizes > 0, waist narrower than the ends by at most two radii, region within the length, please");
  Exit;
EndIf
waist_end = waist_length / 2;
fillet_end = waist_end + Sqrt(radius ^ 2 - (radius - rise) ^ 2);
half = region / 2;
If (fillet_end > length / 2)
  Error("dumbbell: the fillets do not fit into the length");
  Exit;
EndIf

// Stations along x >= 0 at which blocks end, without slivers, and the half width there.
xs[] = {};
hs[] = {};
If (half <= 1.02 * waist_end)
  xs[] += half;
  hs[] += waist_width / 2;
Else
  xs[] += waist_end;
  hs[] += waist_width / 2;
  If (half <= fillet_end + 0.02 * waist_end)
    If (half > fillet_end)
      half = fillet_end;
    EndIf
    xs[] += half;
    hs[] += waist_width / 2 + radius - Sqrt(radius ^ 2 - (half - waist_end) ^ 2);
  Else
    xs[] += {fillet_end, half};
    hs[] += {end_width / 2, end_width / 2};
  EndIf
EndIf
count = #xs[];
across = Ceil(waist_width / size - 1e-6);

// Points from left to right, below and above.
below[] = {};
above[] = {};
For i In {0:2*count-1}
  m = (i < count) ? count - 1 - i : i - count;
  sign = (i < count) ? -1 : 1;
  p = newp; Point(p) = {sign * xs[m], -hs[m], 0};
  below[] += p;
  p = newp; Point(p) = {sign * xs[m], hs[m], 0};
  above[] += p;
EndFor
// Centres of the four fillets: left below, left above, right below, right above.
centre[] = {};
For sx In {-1:1:2}
  For sy In {-1:1:2}
    p = newp; Point(p) = {sx * waist_end, sy * (waist_width / 2 + radius), 0};
    centre[] += p;
  EndFor
EndFor

vertical[] = {};
For i In {0:2*count-1}
  l = newl; Line(l) = {below[i], above[i]};
  Transfinite Curve {l} = across + 1;
  vertical[] += l;
EndFor
blocks[] = {};
sides[] = {};
For i In {0:2*count-2}
  m = (i < count) ? count - 1 - i : i + 1 - count;  // station at the outer end; 0: the waist itself
  pair = (i < count) ? 0 : 2;
  If (m == 1)
    lower = newl; Circle(lower) = {below[i], centre[pair], below[i + 1]};
    upper = newl; Circle(upper) = {above[i], centre[pair + 1], above[i + 1]};
  Else
    lower = newl; Line(lower) = {below[i], below[i + 1]};
    upper = newl; Line(upper) = {above[i], above[i + 1]};
  EndIf
  extent = 2 * xs[0];
  If (m > 0)
    extent = xs[m] - xs[m - 1];
  EndIf
  Transfinite Curve {lower, upper} = Ceil(extent / size - 1e-6) + 1;
  loop = newll; Curve Loop(loop) = {lower, vertical[i + 1], -upper, -vertical[i]};
  s = news; Plane Surface(s) = {loop};
  blocks[] += s;
  sides[] += {lower, upper};
EndFor
Transfinite Surface {blocks[]};
Recombine Surface {blocks[]};

Physical Surface("specimen", 1) = {blocks[]};
Physical Curve("left", 2) = {vertical[0]};
Physical Curve("right", 3) = {vertical[2 * count - 1]};
Physical Curve("sides", 4) = {sides[]};
