"""Line maps, built during a drive or given: data association, submaps with loop closure, relocalisation."""
