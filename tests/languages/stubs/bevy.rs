//! As much of Bevy as examples/engines/bevy.rs calls, with its signatures: Bevy itself compiles for minutes.
pub mod prelude {
    pub use component::Component;
    use std::slice::IterMut;

    /// glam::Quat: x, y, z, w.
    #[derive(Clone, Copy, Debug)]
    pub struct Quat([f32; 4]);
    impl Quat {
        pub const fn from_xyzw(x: f32, y: f32, z: f32, w: f32) -> Quat {
            Quat([x, y, z, w])
        }
        pub fn from_array(a: [f32; 4]) -> Quat {
            Quat(a)
        }
        pub fn to_array(&self) -> [f32; 4] {
            self.0
        }
    }
    pub struct Transform {
        pub rotation: Quat,
    }
    pub struct Mut<'a, T>(pub &'a mut T);
    impl<T> std::ops::Deref for Mut<'_, T> {
        type Target = T;
        fn deref(&self) -> &T {
            self.0
        }
    }
    impl<T> std::ops::DerefMut for Mut<'_, T> {
        fn deref_mut(&mut self) -> &mut T {
            self.0
        }
    }
    pub trait QueryData {
        type Row;
        type Item<'a>;
        fn item(row: &mut Self::Row) -> Self::Item<'_>;
    }
    impl<A: 'static, B: 'static> QueryData for (&mut A, &mut B) {
        type Row = (A, B);
        type Item<'a> = (Mut<'a, A>, Mut<'a, B>);
        fn item(row: &mut (A, B)) -> Self::Item<'_> {
            (Mut(&mut row.0), Mut(&mut row.1))
        }
    }
    pub struct Query<'w, D: QueryData>(pub &'w mut [D::Row]);
    impl<'q, D: QueryData> IntoIterator for &'q mut Query<'_, D> {
        type Item = D::Item<'q>;
        type IntoIter = std::iter::Map<IterMut<'q, D::Row>, fn(&'q mut D::Row) -> D::Item<'q>>;
        fn into_iter(self) -> Self::IntoIter {
            self.0.iter_mut().map(D::item)
        }
    }
}
