"""What can be seen of a textured mesh: renders, switch distances, Weber's threshold, major scales, choice of levels (section IV)."""
