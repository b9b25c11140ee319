"""All above -> ProblemViews: cell and direction interval whose enclosing frustum costs more than the budget."""
