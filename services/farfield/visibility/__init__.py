"""Scene, cells -> VisibleSets: what each view-space cell can see."""
