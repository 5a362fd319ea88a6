"""When scans and the map disagree: wheels that slipped, a robot that is carried, lost, and found again."""
