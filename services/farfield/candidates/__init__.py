"""Hierarchy, ProblemViews -> Candidates: impostors that could be built, their bytes, cost and savings."""
