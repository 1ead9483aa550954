"""What packages need of objects, materials and images."""
