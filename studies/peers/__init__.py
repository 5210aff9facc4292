"""The radar's decision as another library of POMDP solvers plays it."""
