"""The map that a drive builds or is given: lines, association, submaps of a building, relocalisation."""
