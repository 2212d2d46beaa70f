//! Normal equations by Cholesky's factorisation (Golub and Van Loan 2013, section 4.2).

/// Factor of a symmetric matrix (n x n, row by row), in its lower triangle. What depends on what came before has the pivot 0: `false`
/// where there is such a thing.
pub fn factor(a: &mut [f64], n: usize) -> bool {
    let mut whole = true;
    for i in 0..n {
        let own = a[i * n + i];
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let rest = a[i * n + j] - dot;
            let pivot = a[j * n + j];
            a[i * n + j] = if i != j {
                if pivot > 0.0 { rest / pivot } else { 0.0 }
            } else if rest.is_finite() && rest > 1e-14 * own {
                rest.sqrt()
            } else {
                whole = false;
                0.0
            };
        }
    }
    whole
}

/// Solves with a factor, in place; an unknown without a pivot is left out: 0.
pub fn solve(factor: &[f64], b: &mut [f64]) {
    let n = b.len();
    let divided = |value: f64, pivot: f64| if pivot > 0.0 { value / pivot } else { 0.0 };
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| factor[i * n + k] * b[k]).sum();
        b[i] = divided(b[i] - dot, factor[i * n + i]);
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| factor[k * n + i] * b[k]).sum();
        b[i] = divided(b[i] - dot, factor[i * n + i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_solve_and_what_depends_is_left_out() {
        let m = [4.0, 2.0, 0.6, 2.0, 5.0, 1.0, 0.6, 1.0, 3.0];
        let truth = [1.0, -2.0, 0.5];
        let mut b: Vec<f64> = (0..3).map(|i| (0..3).map(|j| m[i * 3 + j] * truth[j]).sum()).collect();
        let mut a = m;
        assert!(factor(&mut a, 3));
        solve(&a, &mut b);
        assert!(b.iter().zip(truth).all(|(b, t)| (b - t).abs() < 1e-12), "{b:?}");
        let mut twice = [1.0, 1.0, 1.0, 1.0];
        assert!(!factor(&mut twice, 2));
        let mut b = [3.0, 3.0];
        solve(&twice, &mut b);
        assert_eq!(b, [3.0, 0.0]);
    }
}
