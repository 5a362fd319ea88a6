"""The map that a drive builds or is given: lines, association, small maps of a building, getting found again."""
