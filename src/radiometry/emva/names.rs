//! Names of the quantities, in the order of the standard's datasheet (release 4.0 Linear, table 2).

/// Name of a quantity, the standard's symbol, and its meaning.
pub type Name = (&'static str, &'static str, &'static str);

/// Headings of a datasheet and the quantities under each.
pub const GROUPS: [(&str, &[Name]); 7] = [
    (
        "Sensitivity",
        &[
            ("QE", "η", "quantum efficiency"),
            ("R", "R", "responsivity"),
            ("K", "K", "overall system gain"),
            ("inverse_K", "1/K", "inverse of overall system gain"),
            ("K_deviation", "|K_i − K|/K", "mean deviation of the photon transfer curve's local slope"),
        ],
    ),
    (
        "Temporal dark noise and threshold",
        &[
            ("sigma_y_dark", "σ_y.dark", "temporal dark noise"),
            ("sigma_d", "σ_d", "temporal dark noise without quantisation"),
            ("u_p_min", "μ_p.min", "absolute sensitivity threshold"),
            ("u_p_min_area", "μ_p.min.area", "absolute sensitivity threshold by area"),
            ("u_e_min", "μ_e.min", "absolute sensitivity threshold"),
            ("u_e_min_area", "μ_e.min.area", "absolute sensitivity threshold by area"),
        ],
    ),
    (
        "Saturation, signal-to-noise ratio, dynamic range",
        &[
            ("u_p_sat", "μ_p.sat", "saturation capacity"),
            ("u_p_sat_area", "μ_p.sat.area", "saturation capacity by area"),
            ("u_e_sat", "μ_e.sat", "saturation capacity"),
            ("u_e_sat_area", "μ_e.sat.area", "saturation capacity by area"),
            ("SNR_max", "SNR_max", "maximum signal-to-noise ratio"),
            ("SNR_max_dB", "SNR_max", "maximum signal-to-noise ratio"),
            ("SNR_max_bit", "SNR_max", "maximum signal-to-noise ratio"),
            ("inverse_SNR_max", "1/SNR_max", "inverse of it"),
            ("DR", "DR", "dynamic range"),
            ("DR_dB", "DR", "dynamic range"),
        ],
    ),
    (
        "Nonuniformity",
        &[
            ("DSNU1288", "DSNU", "dark signal nonuniformity"),
            ("DSNU1288_DN", "DSNU", "dark signal nonuniformity"),
            ("DSNU1288_row", "DSNU.row", "of rows"),
            ("DSNU1288_col", "DSNU.col", "of columns"),
            ("DSNU1288_pixel", "DSNU.pixel", "of pixels"),
            ("PRNU1288", "PRNU", "photoresponse nonuniformity"),
            ("PRNU1288_row", "PRNU.row", "of rows"),
            ("PRNU1288_col", "PRNU.col", "of columns"),
            ("PRNU1288_pixel", "PRNU.pixel", "of pixels"),
        ],
    ),
    (
        "Linearity",
        &[
            ("LE", "LE", "linearity error"),
            ("LE_min", "LE_min", "least deviation from the line"),
            ("LE_max", "LE_max", "greatest deviation from the line"),
        ],
    ),
    (
        "Dark current",
        &[
            ("u_I_mean", "μ_I.mean", "dark current from the mean"),
            ("u_I_mean_DN", "μ_I.mean", "dark current from the mean"),
            ("u_I_var", "μ_I.var", "dark current from the variance"),
            ("u_I_var_DN", "μ_I.var", "dark current from the variance"),
        ],
    ),
    (
        "Variances of the spatial part",
        &[
            ("sigma_2_y_stack", "σ²_y.stack", "temporal variance, bright"),
            ("s_2_y_measured", "s²_y.measured", "spatial variance as measured, bright"),
            ("s_2_y", "s²_y", "spatial variance, bright"),
            ("s_2_y_cav", "s²_y.cav", "of column means, bright"),
            ("s_2_y_rav", "s²_y.rav", "of row means, bright"),
            ("s_2_y_col", "s²_y.col", "columns, bright"),
            ("s_2_y_row", "s²_y.row", "rows, bright"),
            ("s_2_y_pixel", "s²_y.pixel", "pixels, bright"),
            ("sigma_2_y_stack_dark", "σ²_y.stack.dark", "temporal variance, dark"),
            ("s_2_y_measured_dark", "s²_y.measured.dark", "spatial variance as measured, dark"),
            ("s_2_y_dark", "s²_y.dark", "spatial variance, dark"),
            ("s_2_y_cav_dark", "s²_y.cav.dark", "of column means, dark"),
            ("s_2_y_rav_dark", "s²_y.rav.dark", "of row means, dark"),
            ("s_2_y_col_dark", "s²_y.col.dark", "columns, dark"),
            ("s_2_y_row_dark", "s²_y.row.dark", "rows, dark"),
            ("s_2_y_pixel_dark", "s²_y.pixel.dark", "pixels, dark"),
        ],
    ),
];
