from mine import MyDetector
from tank import make

from fusion_sfdia import check_detector, check_plant, compare

if __name__ == "__main__":  # `compare` starts processes that import this file
    check_plant(make)
    check_detector(MyDetector, make)
    result = compare([make], [MyDetector, "loo-glr"], seeds=2, faults=("bias",))
    print("\n".join(result.highlights))
    result.report("comparison.html")
