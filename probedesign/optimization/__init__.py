"""Design optimisation: metrics of a design for a task, parameter sweeps, constrained optimisation and Pareto fronts."""
