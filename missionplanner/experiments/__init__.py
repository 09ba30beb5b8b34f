"""What is measured of the planner and its proofs: figures for a closing note, repeatable from a seed."""
